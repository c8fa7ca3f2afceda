"""``python -m svprep``."""

from svprep.cli import main

main()
