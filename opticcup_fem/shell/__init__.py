"""The layered Kirchhoff-Love shell: kinematics, layers, closures, growth, forms, condensation."""
