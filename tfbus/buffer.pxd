cimport cython
cimport libc.math as math
from tfbus cimport octets
from tfbus.columns cimport Columns
from tfbus.octets cimport edge_t, octets_t
from tfbus.kernel cimport Path
from tfbus.kernel cimport pose_t
from tfbus.transform cimport Transform, TransformStamped
from tfbus.tree cimport Table, Tree

cdef object TF2
cdef long long ALL_STATIC, NO_DATA, _LONGEST_NS
cdef double QUATERNION_TOLERANCE, UNIT_TO_THE_LAST_BIT
cdef Py_ssize_t EDGE_SIZE, POSE_SIZE, STAMP_SIZE, _CHUNK

cdef class Buffer:
    cdef readonly double cache_time_s
    cdef readonly object sampling, rejected, shortfall
    cdef readonly Tree _tree
    cdef cython.pymutex _lock
    cdef readonly object _waiters
    cdef public object clock
    cdef list _listeners, _readers
    cdef object __weakref__

    cpdef _watch(self, waiter, questions, fresh=*)
    cpdef _why_stale(self, questions, fresh)
    cdef bint _insert_one(
        self, TransformStamped transform, bint static, str authority) except -1
    @cython.locals(i=Py_ssize_t, stamp=cython.longlong, x=double, y=double, z=double, qx=double,
                   qy=double, qz=double, qw=double, total=double, square=double, error=double,
                   scale=double, pose=pose_t, taken=Py_ssize_t, parent=str, child=str,
                   frames=tuple, edge=edge_t, edges=octets_t, table=Table, why=str,
                   stamps=octets_t, poses=octets_t)
    cdef Py_ssize_t _insert_rows(self, Columns columns, bint static, str authority) except -1
    cdef Path _ask_path(self, target_frame, source_frame)
    @cython.locals(count=Py_ssize_t, stop=Py_ssize_t)
    cdef Py_ssize_t _fill_along(
        self, Path path, const long long[::1] stamps, Py_ssize_t start, double[::1] xyz,
        double[::1] quat, unsigned char[::1] known, bint screw) noexcept nogil
    @cython.locals(path=Path, start=Py_ssize_t, before=Py_ssize_t, stop=Py_ssize_t, i=Py_ssize_t,
                   count=Py_ssize_t, strict=cython.bint, screw=cython.bint,
                   answer=TransformStamped)
    cdef _fill_chunks(
        self, target_frame, source_frame, const long long[::1] stamps, double[::1] xyz,
        double[::1] quat, unsigned char[::1] known, sampling)

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double)
cdef _write_row(TransformStamped answer, Py_ssize_t i, double[::1] xyz, double[::1] quat,
                unsigned char[::1] known)
