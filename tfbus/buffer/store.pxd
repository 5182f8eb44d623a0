cimport cython
from tfbus.geometry.columns cimport Columns
from tfbus.buffer.insert_many cimport Intake
from tfbus.core.kernel cimport Path
from tfbus.geometry.transform cimport TransformStamped
from tfbus.buffer.tree cimport Tree

cdef object TF2
cdef long long LONGEST_NS

cdef class Store:
    cdef readonly double cache_time_s
    cdef readonly object sampling, rejected, shortfall
    cdef readonly Tree _tree
    cdef Intake _intake
    cdef cython.pymutex _lock
    cdef readonly object _waiters
    cdef public object clock
    cdef list _listeners, _readers
    cdef readonly dict _expected_pasts
    cdef object __weakref__

    cdef bint _insert_one(
        self, TransformStamped transform, bint static, str authority) except -1
    cdef Path _ask_path(self, target_frame, source_frame)
