cimport cython

cdef Py_ssize_t _LEAST_ROWS, _MOST_ROWS, _ROWS_OF_BUCKET, _MOST_BUCKETS

@cython.locals(count=Py_ssize_t, least=double, most=double)
cpdef by_time(stamps)
@cython.locals(i=Py_ssize_t)
cdef bint _are_sorted(const long long[::1] stamps) noexcept nogil
@cython.locals(i=Py_ssize_t, at=Py_ssize_t, bucket=Py_ssize_t, pace=double)
cdef void _distribute(
    const long long[::1] stamps, double least, double most, int[::1] starts,
    int[::1] rows) noexcept nogil
cdef Py_ssize_t _bucket(double since, double pace) noexcept nogil
