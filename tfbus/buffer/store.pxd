cimport cython
from tfbus.buffer.lock cimport Lock
from tfbus.buffer.insert_many cimport BatchInserter
from tfbus.geometry.kernel cimport Path
from tfbus.geometry.transform cimport TransformStamped, child_name
from tfbus.buffer.tree cimport Tree

cdef object TF2
cdef long long LONGEST_NS

@cython.final
cdef class Store:
    cdef readonly Lock lock
    cdef readonly Tree tree
    cdef BatchInserter inserter
    cdef readonly object sampling, rejected, expired_lookups, waiters
    cdef public object clock
    cdef public bint is_ended
    cdef readonly dict expected_pasts
    cdef list _listeners, _watchers
    cdef object _once

    cdef bint insert(self, TransformStamped transform, bint static, str authority) except -1
    cdef Path path(self, target_frame, source_frame)
    cpdef notify(self)
    cpdef report_questions(self)
    cdef _warn_crowded(self)
