"""`python -m opticcup_fem` is the command `opticcup`."""

from opticcup_fem.cli import main

if __name__ == "__main__":
    main()
