"""svprep: exact shadow volumes for any city mesh, prepared once, cached in one file."""

__version__ = "0.1.0"
