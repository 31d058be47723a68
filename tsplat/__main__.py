"""``python -m tsplat``."""

from tsplat.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
