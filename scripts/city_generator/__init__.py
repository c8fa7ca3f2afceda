"""A seeded generator of a dirty city: the parts behind ``scripts/make_city.py``.

``layout`` decides where objects stand, ``buildings`` and ``street`` shape them,
``terrain`` shapes the ground, ``defects`` damages meshes, ``writer`` writes
Wavefront OBJ, and ``city`` is the outline that joins them.
"""
