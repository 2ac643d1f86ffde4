"""`python -m hitchid` is `hitchid`."""

from hitchid.start import main

if __name__ == "__main__":
    main()
