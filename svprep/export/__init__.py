"""Export: the repaired mesh of a cache as a model file, in the frame of its sources.

    city       a cache -> `City`: what the formats write
    header     comment lines of OBJ and PLY that tell what the format itself cannot
    obj, ply, glb, cityjson   a `City` -> the parts of a file
    output     which format a name asks for, guards, writing whole or not at all

Exact: positions are multiples of the grid's step, and every format writes them so that
they read back bit for bit. A build of an exported file gives the tables of the cache
again, vertex by vertex and face by face: positions, faces, objects with their names,
components, planes, edges, silhouette and scene trees. Vertices keep their numbers because
`repair` numbers them as a build of the repaired mesh does, by first use. What it cannot give
again is what the export does not hold:

- the sources and their digests, the configuration, the notes, the lights;
- ``source_face``: faces are counted anew, in the order of the cache;
- the repair record: what was dropped is not there, what was turned is turned already (so no
  component is flagged as turned outward);
- surfaces in OBJ; in CityJSON the type of an object that is none of CityJSON's (one without
  a type gets one), its id where two objects share it, a CRS that has no EPSG code;
- objects without faces, save in PLY (all formats name them, and the summary counts them);
- the grid, where a face that was dropped reached farthest out: the summary says so.
"""
