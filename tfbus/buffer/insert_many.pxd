cimport cython
from tfbus.geometry cimport packed
from tfbus.geometry.columns cimport Columns
from tfbus.geometry.kernel cimport History, append_rows, off_unit, pose_t, samples_t, unit
from tfbus.geometry.packed cimport edge_t
from tfbus.buffer.lock cimport Lock
from tfbus.buffer.tree cimport Tree

cdef Py_ssize_t EDGE_SIZE, POSE_SIZE, STAMP_SIZE, _LEAST_ROWS, _ROWS_AT_A_TIME
cdef long long LONGEST_NS
cdef double QUATERNION_TOLERANCE, UNIT_TO_THE_LAST_BIT

@cython.final
cdef class Permit:
    cdef public bint is_valid

@cython.final
cdef class Table:
    cdef tuple frames
    cdef bytes edges
    cdef list children
    cdef long long topology, assignments
    cdef unsigned long long[::1] addresses
    cdef samples_t** samples

    @cython.locals(i=Py_ssize_t, child=History)
    cdef _set_samples(self, list children)

@cython.final
cdef class BatchInserter:
    cdef Tree _tree
    cdef object _rejected
    cdef Lock _lock
    cdef dict _tables

    @cython.locals(
        table=Table, stored=Py_ssize_t, at=Py_ssize_t, start=Py_ssize_t, slow=Py_ssize_t)
    cdef Py_ssize_t insert(
        self, Columns columns, bint static, str authority, Permit permit) except -1
    @cython.locals(at=Py_ssize_t)
    cdef Py_ssize_t _append(self, Table table, Columns columns, Py_ssize_t start) except -1
    @cython.locals(stamp_ns=cython.longlong, pose=pose_t, edge=edge_t, parent=str, child=str,
                   error=double)
    cdef bint _insert_row(
        self, Columns columns, Py_ssize_t at, bint static, str authority) except -1
    cdef bint _holds(self, Table table) noexcept
    @cython.locals(table=Table)
    cdef Table _table(self, Columns columns, str authority)
    @cython.locals(i=Py_ssize_t, edge=edge_t, child=History, parent=History, children=list)
    cdef Table _find_table(self, Columns columns, str authority)
