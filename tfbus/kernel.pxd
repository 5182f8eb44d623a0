cimport cython
cimport libc.math as math

ctypedef (double, double, double, double, double, double, double) pose_t
ctypedef (double, double, double, double, double, double) twist_t

cdef double _SERIES_BELOW
cdef double _SMALL_ANGLE

@cython.locals(ax=double, ay=double, az=double, apx=double, apy=double, apz=double, apw=double, bx=double, by=double, bz=double, bpx=double, bpy=double, bpz=double, bpw=double, tx=double, ty=double, tz=double)
cpdef pose_t compose(pose_t a, pose_t b) noexcept nogil

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double, tx=double, ty=double, tz=double)
cpdef pose_t invert(pose_t a) noexcept nogil

cpdef pose_t between(pose_t a, pose_t b) noexcept nogil

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double, scale=double)
cpdef pose_t normalised(pose_t a) noexcept nogil

@cython.locals(ax=double, ay=double, az=double, apx=double, apy=double, apz=double, apw=double, bx=double, by=double, bz=double, bpx=double, bpy=double, bpz=double, bpw=double, cosine=double, sign=double, rest=double, short=double, u=double, v=double, angle=double, scale=double)
cpdef pose_t blend(pose_t a, pose_t b, double ratio) noexcept nogil

@cython.locals(third=double, second=double)
cdef double _weight(double short, double square) noexcept nogil

@cython.locals(vx=double, vy=double, vz=double, wx=double, wy=double, wz=double)
@cython.locals(step=pose_t)
cpdef pose_t blend_screw(pose_t a, pose_t b, double ratio) noexcept nogil

@cython.locals(square=double, angle=double, a=double, b=double, s=double, ax=double, ay=double, az=double)
cpdef pose_t exp_twist(double vx, double vy, double vz, double wx, double wy, double wz) noexcept nogil

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double, sine=double, half=double, s=double, c=double, wx=double, wy=double, wz=double, ax=double, ay=double, az=double)
cpdef twist_t log_pose(pose_t p) noexcept nogil

cdef long long ALL_STATIC, CONFLICT, KEPT, NO_DATA, REPEATED, TOO_OLD
cdef Py_ssize_t _FIRST_CAPACITY

# `elapsed` is a double, so that what is divided is not whole numbers.

@cython.final
cdef class History:
    cdef readonly str name
    cdef readonly History parent
    cdef readonly bint static
    cdef pose_t fixed
    cdef long long fixed_stamp
    cdef long long[::1] stamps
    cdef double[::1] poses
    cdef readonly list parents
    cdef Py_ssize_t capacity, head, tail, at
    cdef double ratio
    cdef long long beyond
    cdef public str authority
    cdef public bint gone
    cdef readonly long long conflicts, refused
    cdef dict paths
    cdef public object alarms

    @cython.locals(head=Py_ssize_t, last=Py_ssize_t, at=Py_ssize_t, before=cython.longlong,
                   elapsed=double)
    cdef bint seek(self, long long stamp_ns) noexcept
    @cython.locals(at=Py_ssize_t, near=cython.longlong)
    cdef bint seek_nearest(self, long long stamp_ns, long long tolerance_ns) noexcept
    @cython.locals(first=Py_ssize_t, last=Py_ssize_t, at=Py_ssize_t, beyond=cython.longlong,
                   before=cython.longlong, elapsed=double)
    cdef bint seek_beyond(self, long long stamp_ns, long long extrapolation_ns) noexcept
    cdef pose_t pose(self, bint screw) noexcept
    cdef History parent_here(self)
    cpdef long long latest(self) noexcept
    cpdef Py_ssize_t count(self)
    @cython.locals(low=Py_ssize_t, high=Py_ssize_t, guess=Py_ssize_t, step=Py_ssize_t,
                   middle=Py_ssize_t, oldest=cython.longlong, newest=cython.longlong, period=cython.longlong)
    cdef Py_ssize_t _find(self, long long stamp_ns) noexcept
    @cython.locals(k=Py_ssize_t)
    cdef pose_t _sample(self, Py_ssize_t at) noexcept

    cdef int fix(self, long long stamp_ns, pose_t pose, History parent) except -1
    @cython.locals(tail=Py_ssize_t, oldest=cython.longlong)
    cdef int insert(
        self, long long stamp_ns, pose_t pose, History parent, long long cache_ns) except -1
    cdef unfix(self)
    cdef History parent_after(self, long long stamp_ns, History parent, bint static)
    cpdef forget(self)
    cpdef forget_samples(self)
    @cython.locals(tail=Py_ssize_t)
    cpdef forget_after(self, long long stamp_ns)
    @cython.locals(at=Py_ssize_t, before=Py_ssize_t, tail=Py_ssize_t)
    cdef int _insert_late(
        self, long long stamp_ns, pose_t pose, History parent, long long cache_ns) except -1
    cdef int _replace(self, Py_ssize_t at, pose_t pose, History parent) except -1
    cdef bint _is_fixed_at(self, pose_t pose, History parent)
    cdef _change_parent(self, History parent)
    @cython.locals(head=Py_ssize_t, tail=Py_ssize_t, alive=Py_ssize_t, stamps='long long[::1]',
                   poses='double[::1]')
    cdef _make_room(self)
    @cython.locals(k=Py_ssize_t, x=double, y=double, z=double, qx=double, qy=double, qz=double,
                   qw=double)
    cdef void _write(self, Py_ssize_t at, pose_t pose) noexcept

@cython.final
cdef class Path:
    cdef readonly History target, source
    cdef readonly list up, down
    cdef readonly long long topology

    cpdef list edges(self)
    @cython.locals(history=History, top=History)
    cpdef list names(self)
    @cython.locals(history=History)
    cpdef bint is_mixed(self) except -1
    @cython.locals(history=History, latest=cython.longlong)
    cpdef long long latest(self) except *
    @cython.locals(history=History)
    cdef bint seek(self, long long stamp_ns) except -1
    @cython.locals(history=History, beyond=cython.longlong)
    cdef long long seek_as(self, long long stamp_ns, sampling) except *
    @cython.locals(back=pose_t)
    cdef pose_t pose(self, bint screw) except *
    @cython.locals(i=Py_ssize_t, x=double, y=double, z=double, qx=double, qy=double, qz=double,
                   qw=double)
    cpdef fill(self, const long long[::1] stamps, Py_ssize_t start, Py_ssize_t stop,
               double[::1] xyz, double[::1] quat, unsigned char[::1] known, bint screw)

@cython.locals(history=History, pose=pose_t, i=Py_ssize_t)
cdef pose_t climb(list histories, bint screw) except *
cpdef bint seek_as(History history, long long stamp_ns, sampling) except -1
