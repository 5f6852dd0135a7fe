"""`python -m fabdesign`."""

from fabdesign.cli import main

if __name__ == "__main__":
    main()
