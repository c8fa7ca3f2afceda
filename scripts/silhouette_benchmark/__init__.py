"""What `benchmark_silhouette.py` is made of: data, baselines, measuring, report."""
