cimport cython
from tfbus.geometry cimport packed
from tfbus.geometry.packed cimport edge_t
from tfbus.geometry.transform cimport TransformStamped, child_name

cdef Py_ssize_t EDGE_SIZE, STAMP_SIZE

@cython.final
cdef class Columns:
    cdef readonly tuple frames
    cdef readonly Py_ssize_t count
    cdef readonly bytes edges, stamps, poses
    cdef readonly Py_ssize_t edges_at, stamps_at, poses_at

    @cython.locals(columns=Columns)
    cpdef Columns with_frames(self, tuple frames)
    cpdef last_stamp_ns(self)
    @cython.locals(size=Py_ssize_t)
    cdef bint is_like(self, tuple frames, bytes edges) except -1
    @cython.locals(edge=edge_t)
    cdef str last_child(self)
    @cython.locals(edge=edge_t)
    cdef TransformStamped _transform(self, Py_ssize_t row)

@cython.final
cdef class Kind:
    cdef tuple frames
    cdef bytes edges
    cdef object found

@cython.final
cdef class FoundOfRows:
    cdef readonly Py_ssize_t count
    cdef Py_ssize_t _most
    cdef dict _kinds

    @cython.locals(kind=Kind)
    cpdef get(self, Columns columns)
    @cython.locals(former=Kind)
    cpdef put(self, Columns columns, object found)

@cython.locals(stamps=bytes, columns=Columns)
cpdef Columns columns_of_batch(batch)
@cython.locals(one=TransformStamped, index_of=dict, edges=list, stamps=list, poses=list,
               parent=Py_ssize_t, child=Py_ssize_t)
cdef Columns _of_list(list transforms)
