"""Repair: every defect decided once, recorded, and never at the cost of a shadow.

grid.py       the quantisation grid
weld.py       grid positions, welding, faces without area
winding.py    patches wound alike, duplicates, closed components outward
split.py      half-edges grouped by edge and paired, components
solid.py      which closed components are safe for the closed volume
report.py     what was decided, per object and face
"""
