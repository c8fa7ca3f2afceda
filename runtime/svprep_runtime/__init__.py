"""The runtime of svprep: streams a cache into shadow passes, and judges the result.

It reads caches, lights and silhouettes; it prepares nothing.
"""
