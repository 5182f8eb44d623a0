"""Stands in for `import cython` where the kernel is interpreted and Cython is not installed."""

from contextlib import nullcontext

compiled = False
nogil = nullcontext()
