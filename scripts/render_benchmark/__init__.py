"""What `scripts/benchmark_render.py` measures, and how it reports it."""
