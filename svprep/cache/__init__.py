"""The cache: one HDF5 file, written whole or not at all, that names its own damage.

    schema   what the file holds: one declaration per dataset and attribute
    codec    `model.Prepared` <-> the stored arrays
    files    lock, temporary sibling, atomic replacement
    writer   `write_cache`
    reader   `open_cache`
    vtkhdf   the group that shows the mesh to ParaView: `write_vtk`, `check_vtk`
    verify   `verify`: the quick structural check (tables in `invariants`, silhouette
             trees in `tree_invariants` and `tree_bounds`)

FORMAT.md describes the file for readers in other languages.
"""
