"""The triangles of a robot's mesh files, read in a process of their own: files of strangers too."""
