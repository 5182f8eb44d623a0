from tfbus.buffer.lookup_many cimport Filling
from tfbus.core.kernel cimport Path

cdef long long ALL_STATIC, NO_DATA

cdef class Buffer(Filling):
    pass
