cimport cython

cdef Py_ssize_t _LEAST_ROWS, _MOST_ROWS, _ROWS_OF_BUCKET, _MOST_BUCKETS

@cython.locals(count=Py_ssize_t)
cpdef by_time(stamps)
@cython.locals(i=Py_ssize_t)
cdef bint _are_sorted(const long long[::1] stamps) noexcept nogil
@cython.locals(i=Py_ssize_t, at=Py_ssize_t, bucket=Py_ssize_t, last=Py_ssize_t, pace=double,
               way=double)
cdef void _distribute(
    const long long[::1] stamps, double least, double most, int[::1] starts,
    unsigned short[::1] buckets, int[::1] rows) noexcept
