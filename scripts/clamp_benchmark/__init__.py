"""The parts of `scripts/benchmark_clamp.py`."""
