cimport cython
from tfbus.core cimport packed
from tfbus.geometry.transform cimport TransformStamped, child_name

@cython.final
cdef class OneMessage:
    cdef str _frame_id, _child_frame_id
    cdef bytes _head, _stamps, _poses

    cpdef bytes encode_bytes(self, object seq, tuple frames, long long stamp_ns, bytes pose)
    cpdef bytes encode(self, object seq, TransformStamped transform)
