cimport cython
from tfbus.core cimport packed
from tfbus.geometry.transform cimport TransformStamped, child_name

cdef Py_ssize_t STAMP_SIZE

@cython.final
cdef class Columns:
    cdef readonly tuple frames
    cdef readonly Py_ssize_t count
    cdef readonly bytes edges, stamps, poses
    cdef readonly Py_ssize_t edges_at, stamps_at, poses_at

    @cython.locals(columns=Columns)
    cpdef Columns with_frames(self, tuple frames)
    cpdef last_stamp_ns(self)

@cython.locals(one=TransformStamped, index_of=dict, edges=list, stamps=list, poses=list,
               parent=Py_ssize_t, child=Py_ssize_t)
cdef Columns _of_list(list transforms)
