"""Export: the repaired mesh of a cache as a model file, in the frame of its sources.

    city       a cache -> `City`: what the formats write
    header     comment lines of OBJ and PLY that tell what the format itself cannot
    obj, ply, glb, cityjson   a `City` -> the parts of a file
    output     which format a name asks for, guards, writing whole or not at all

Exact: positions are multiples of the grid's step, and every format writes them so that
they read back bit for bit. A build of an exported file gives the tables of the cache
again: positions, faces, objects with their names, components, planes, edges, silhouette
and scene trees. What it cannot give again is what the export does not hold:

- the sources and their digests, the configuration, the notes, the lights;
- ``source_face``: faces are counted anew, in the order of the cache;
- the repair record: what was dropped is not there, what was turned is turned already (so no
  component is flagged as turned outward);
- surfaces in OBJ; the type of an object in CityJSON that is none of CityJSON's, and its id
  where two objects share it; a CRS in CityJSON that is no EPSG code;
- objects without faces, save in PLY (all formats name them, and the summary counts them);
- the numbers of vertices, where the repair turned, dropped or moved faces: a build numbers
  them by first use. The tables are then the same but for these numbers, and from the
  second export on they are the same altogether;
- the grid, where a face that was dropped reached farthest out: the summary says so.
"""
