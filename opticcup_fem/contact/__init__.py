"""Contact of a shell with itself and with rigid obstacles, thickness respected."""
