"""A robot as its URDF describes it: links, joints, shapes, and where the links are."""
