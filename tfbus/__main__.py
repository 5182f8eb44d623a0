"""`python -m tfbus` is the `tfbus` command."""

from tfbus.cli import main

if __name__ == "__main__":
    main()
