"""Equilibria of a shell: one state (Newton), a jump (relaxation), a path (load stepping)."""
