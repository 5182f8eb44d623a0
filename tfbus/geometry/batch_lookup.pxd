cimport cython
cimport libc.math as math
from tfbus.geometry.kernel cimport (
    Path, invert, locate, pose_at, pose_t, sample, samples_ptr, samples_t, sclerp)

cdef Py_ssize_t _ROWS, _LEAST_ORDERED, _MOST_ORDERED, _ROWS_OF_BUCKET, _MOST_BUCKETS
cdef double _SERIES_BELOW, _NOTHING
cdef long long NO_DATA

# Of _ROWS rows.
cdef struct block_t:
    long long stamps_ns[64]
    Py_ssize_t row[64]
    double x[64]
    double y[64]
    double z[64]
    double qx[64]
    double qy[64]
    double qz[64]
    double qw[64]
    double step_x[64]
    double step_y[64]
    double step_z[64]
    double step_qx[64]
    double step_qy[64]
    double step_qz[64]
    double step_qw[64]
    double ratio[64]
    unsigned char known[64]

ctypedef block_t* block_ptr

@cython.locals(space=block_t, block=block_ptr, count=Py_ssize_t, i=Py_ssize_t)
cpdef void fill(
    Path path, const long long[::1] stamps, const int[::1] rows, Py_ssize_t start, Py_ssize_t stop,
    double[::1] xyz, double[::1] quat, unsigned char[::1] known, bint screw) noexcept nogil
@cython.locals(j=Py_ssize_t, is_ordered=cython.bint)
cdef void _begin(
    block_t* block, const long long[::1] stamps, const int[::1] rows, Py_ssize_t start,
    Py_ssize_t count) noexcept nogil
@cython.locals(
    start=Py_ssize_t, stop=Py_ssize_t, before=cython.longlong, after=cython.longlong, ratio=double,
    is_between=cython.bint)
cdef void _step(
    block_t* block, samples_t* samples, Py_ssize_t count) noexcept nogil
@cython.locals(
    j=Py_ssize_t, ax=double, ay=double, az=double, apx=double, apy=double, apz=double, apw=double,
    bx=double, by=double, bz=double, bpx=double, bpy=double, bpz=double, bpw=double,
    before=cython.longlong, cosine=double, short=double, angle=double, scale=double,
    elapsed=double, period=double, ratio=double,
    rest=double, u=double, v=double)
cdef void _interpolate(
    block_t* block, samples_t* samples, Py_ssize_t start, Py_ssize_t stop) noexcept nogil
@cython.locals(third=double, second=double)
cdef double _weight(double short, double square) noexcept nogil
@cython.locals(j=Py_ssize_t, ratio=double, a=pose_t, b=pose_t)
cdef void _step_screw(
    block_t* block, samples_t* samples, Py_ssize_t count) noexcept nogil
cdef pose_t _missing(block_t* block, Py_ssize_t j) noexcept nogil
@cython.locals(
    x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double)
cdef void _set_step(block_t* block, Py_ssize_t j, pose_t pose) noexcept nogil
@cython.locals(j=Py_ssize_t)
cdef void _take(block_t* block, Py_ssize_t count) noexcept nogil
@cython.locals(
    j=Py_ssize_t, apx=double, apy=double, apz=double, apw=double, bx=double, by=double, bz=double,
    bpx=double, bpy=double, bpz=double, bpw=double, tx=double, ty=double, tz=double)
cdef void _compose(block_t* block, Py_ssize_t count) noexcept nogil
@cython.locals(
    j=Py_ssize_t, pose=pose_t, x=double, y=double, z=double, qx=double, qy=double, qz=double,
    qw=double)
cdef void _invert(block_t* block, Py_ssize_t count) noexcept nogil
@cython.locals(
    i=Py_ssize_t, j=Py_ssize_t, qx=double, qy=double, qz=double, qw=double, scale=double)
cdef void _write(
    block_t* block, Py_ssize_t count, double[::1] xyz, double[::1] quat,
    unsigned char[::1] known) noexcept nogil

@cython.locals(count=Py_ssize_t)
cpdef by_time(stamps)
@cython.locals(i=Py_ssize_t)
cdef bint _are_sorted(const long long[::1] stamps) noexcept nogil
@cython.locals(i=Py_ssize_t, at=Py_ssize_t, bucket=Py_ssize_t, last=Py_ssize_t, pace=double,
               way=double)
cdef void _distribute(
    const long long[::1] stamps, double least, double most, int[::1] starts,
    unsigned short[::1] buckets, int[::1] rows) noexcept
