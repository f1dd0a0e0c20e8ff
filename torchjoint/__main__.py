"""`python -m torchjoint` is the command `torchjoint`."""

from torchjoint.cli import main

if __name__ == "__main__":
    main()
