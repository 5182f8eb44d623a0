cimport cython
cimport libc.math as math

from tfbus.geometry cimport packed
from tfbus.geometry.packed cimport octets_t, pose_t

cdef extern from *:
    """
    #define tfbus_untrack(object) PyObject_GC_UnTrack((PyObject*) (object))
    #define tfbus_track(object) PyObject_GC_Track((PyObject*) (object))
    #define tfbus_is_tracked(object) PyObject_GC_IsTracked((PyObject*) (object))
    /* Numbers, which refer to nothing: the memoryview and its array. */
    #define tfbus_untrack_view(view) do { \\
        PyObject_GC_UnTrack((view).memview); \\
        PyObject_GC_UnTrack((view).memview->obj); \\
    } while (0)
    """
    void tfbus_untrack(object each) noexcept
    void tfbus_track(object each) noexcept
    bint tfbus_is_tracked(object each) noexcept
    void tfbus_untrack_view "tfbus_untrack_view" (long long[::1] view) noexcept
    void tfbus_untrack_poses "tfbus_untrack_view" (double[::1] view) noexcept

ctypedef (double, double, double, double, double, double) twist_t

cdef double _SERIES_BELOW
cdef double _SMALL_ANGLE

@cython.locals(ax=double, ay=double, az=double, apx=double, apy=double, apz=double, apw=double, bx=double, by=double, bz=double, bpx=double, bpy=double, bpz=double, bpw=double, tx=double, ty=double, tz=double)
cpdef pose_t compose(pose_t a, pose_t b) noexcept nogil

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double, tx=double, ty=double, tz=double)
cpdef pose_t invert(pose_t a) noexcept nogil

cpdef pose_t relative(pose_t a, pose_t b) noexcept nogil

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double, scale=double)
cpdef pose_t normalised(pose_t a) noexcept nogil

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double,
               total=double, square=double)
cdef double off_unit(pose_t pose) noexcept nogil

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double,
               scale=double)
cdef pose_t unit(pose_t pose, double error) noexcept nogil

@cython.locals(ax=double, ay=double, az=double, apx=double, apy=double, apz=double, apw=double, bx=double, by=double, bz=double, bpx=double, bpy=double, bpz=double, bpw=double, cosine=double, sign=double, rest=double, short=double, u=double, v=double, angle=double, scale=double)
cpdef pose_t lerp_slerp(pose_t a, pose_t b, double ratio) noexcept nogil

@cython.locals(third=double, second=double)
cdef double _weight(double short, double square) noexcept nogil

@cython.locals(vx=double, vy=double, vz=double, wx=double, wy=double, wz=double)
@cython.locals(step=pose_t)
cpdef pose_t sclerp(pose_t a, pose_t b, double ratio) noexcept nogil

@cython.locals(square=double, angle=double, a=double, b=double, s=double, ax=double, ay=double, az=double)
cpdef pose_t exp_twist(double vx, double vy, double vz, double wx, double wy, double wz) noexcept nogil

@cython.locals(x=double, y=double, z=double, qx=double, qy=double, qz=double, qw=double, sine=double, half=double, s=double, c=double, wx=double, wy=double, wz=double, ax=double, ay=double, az=double)
cpdef twist_t log_pose(pose_t p) noexcept nogil

cdef struct samples_t:
    long long* stamps
    double* poses
    Py_ssize_t head
    Py_ssize_t tail
    Py_ssize_t capacity
    Py_ssize_t here
    Py_ssize_t following
    long long before
    long long after
    long long newest
    double pace
    bint is_static
    bint mixed
    pose_t static_pose

ctypedef samples_t* samples_ptr
ctypedef long long* stamps_ptr
ctypedef double* poses_ptr

cdef long long ALL_STATIC, CONFLICT, CROWDED, KEPT, LONGEST_NS, NO_DATA, REPEATED, TOO_OLD
cdef Py_ssize_t POSE_SIZE, STAMP_SIZE, _FIRST_CAPACITY
cdef double OUTSIDE, QUATERNION_TOLERANCE, UNIT_TO_THE_LAST_BIT

# `elapsed` and `period` of a ratio are doubles, so that what is divided is not whole numbers.

cdef Py_ssize_t slot(samples_t* samples, Py_ssize_t at) noexcept nogil
@cython.locals(before=cython.longlong, after=cython.longlong, elapsed=double, period=double)
cdef double locate(samples_t* samples, long long stamp_ns) noexcept nogil
cdef double locate_as(
    samples_t* samples, samples_t* other, double ratio, long long stamp_ns) noexcept nogil
cdef void set_cursor_as(samples_t* samples, samples_t* other, long long stamp_ns) noexcept nogil
cdef void set_cursor(samples_t* samples, Py_ssize_t at) noexcept nogil
cdef void invalidate(samples_t* samples) noexcept nogil
@cython.locals(stamps=stamps_ptr, low=Py_ssize_t, high=Py_ssize_t, start=Py_ssize_t,
               guess=Py_ssize_t, tried=Py_ssize_t, step=Py_ssize_t, middle=Py_ssize_t,
               last=cython.longlong, way=double)
cdef Py_ssize_t find(samples_t* samples, long long stamp_ns) noexcept nogil
cdef pose_t pose_at(samples_t* samples, double ratio) noexcept nogil
cdef pose_t screw_at(samples_t* samples, double ratio) noexcept nogil
@cython.locals(poses=poses_ptr, k=Py_ssize_t)
cdef pose_t sample(samples_t* samples, Py_ssize_t place) noexcept nogil
cdef bint append(
    samples_t* samples, long long stamp_ns, pose_t pose, long long cache_ns) noexcept nogil
@cython.locals(at=Py_ssize_t, stamp_ns=cython.longlong, pose=pose_t, error=double)
cdef Py_ssize_t append_rows(
    samples_t** edges, octets_t stamps, Py_ssize_t stamps_at, octets_t poses, Py_ssize_t poses_at,
    Py_ssize_t start, Py_ssize_t count, long long cache_ns) noexcept nogil
cdef void push(
    samples_t* samples, long long stamp_ns, pose_t pose, long long cache_ns) noexcept nogil
@cython.locals(stamps=stamps_ptr)
cdef void expire(samples_t* samples, long long oldest_ns) noexcept nogil
@cython.locals(poses=poses_ptr, k=Py_ssize_t, x=double, y=double, z=double, qx=double, qy=double,
               qz=double, qw=double)
cdef void write(
    samples_t* samples, Py_ssize_t place, long long stamp_ns, pose_t pose) noexcept nogil
@cython.locals(i=Py_ssize_t, place=Py_ssize_t)
cdef void shift(samples_t* samples, Py_ssize_t at) noexcept nogil

# Without `trashcan` the end of a long chain of frames would overflow the stack of C.
@cython.final
@cython.trashcan(True)
cdef class History:
    cdef samples_t own
    cdef samples_t* samples
    cdef readonly str name
    cdef readonly History parent
    cdef long long static_stamp
    cdef long long[::1] stamps
    cdef double[::1] poses
    cdef readonly list parents
    cdef readonly dict interruptions
    cdef double ratio
    cdef long long beyond, mixed_until
    cdef public str authority
    cdef public bint gone, ended, removed
    cdef readonly Py_ssize_t children
    cdef readonly long long conflicts, refused, crowded_out
    cdef dict paths
    cdef public object alarms

    @cython.locals(history=History)
    cpdef track(self)
    cdef bint seek(self, long long stamp_ns) noexcept
    @cython.locals(samples=samples_ptr, at=Py_ssize_t)
    cdef bint seek_nearest(self, long long stamp_ns, long long tolerance_ns) noexcept
    @cython.locals(samples=samples_ptr, at=Py_ssize_t, beyond=cython.longlong,
                   oldest=cython.longlong, elapsed=double, period=double)
    cdef bint seek_beyond(
        self, long long stamp_ns, long long extrapolation_ns, long long max_gap_ns) noexcept
    cdef pose_t pose(self, bint screw) noexcept
    @cython.locals(above=History)
    cdef History parent_here(self)
    cpdef Py_ssize_t count(self)
    cdef long long _stamp(self, Py_ssize_t at) noexcept
    @cython.locals(above=History)
    cdef History _parent_of(self, Py_ssize_t at)
    cdef bint _is_change(self) noexcept
    cdef bint _is_interrupted(self) noexcept
    @cython.locals(samples=samples_ptr)
    cdef bint _is_apart(self, long long stamp_ns, long long max_gap_ns) noexcept
    @cython.locals(samples=samples_ptr)
    cpdef tuple around(self, long long stamp_ns)
    cpdef str interruption(self, long long stamp_ns)
    cpdef interrupt(self, str reason)
    cdef _set_interruptions(self, dict interruptions)
    @cython.locals(known=dict, oldest=cython.longlong)
    cdef _forget_interruptions(self)

    cdef bint append(self, long long stamp_ns, pose_t pose, long long cache_ns) noexcept
    cdef int set_static(self, long long stamp_ns, pose_t pose, History parent) except -1
    @cython.locals(samples=samples_ptr, newest=cython.longlong)
    cdef int insert(
        self, long long stamp_ns, pose_t pose, History parent, long long cache_ns,
        Py_ssize_t max_samples) except -1
    cdef bint is_too_old(self, long long stamp_ns, long long cache_ns) noexcept
    cdef bint is_repeated_by(self, str parent_frame, pose_t pose)
    @cython.locals(above=History)
    cdef History parent_after(self, long long stamp_ns, History parent, bint static)
    cdef set_parent(self, History parent)
    cpdef forget_removed(self)
    cpdef forget(self)
    @cython.locals(samples=samples_ptr)
    cpdef forget_samples(self)
    @cython.locals(tail=Py_ssize_t)
    cpdef forget_after(self, long long stamp_ns)
    @cython.locals(samples=samples_ptr, at=Py_ssize_t, behind=Py_ssize_t, i=Py_ssize_t)
    cdef int _insert_late(
        self, long long stamp_ns, pose_t pose, History parent, Py_ssize_t max_samples) except -1
    @cython.locals(known=History, place=Py_ssize_t)
    cdef int _replace(self, Py_ssize_t at, pose_t pose, History parent) except -1
    cdef bint _is_static_at(self, pose_t pose, History parent)
    cdef _unset_static(self)
    cdef long long _newest_sample(self) noexcept
    cdef void _set_newest(self) noexcept
    cdef _change_parent(self, History parent)
    cdef _track_parents(self, long long until_ns)
    @cython.locals(parent=History)
    cdef _set_parents(self, list parents)
    @cython.locals(samples=samples_ptr, alive=Py_ssize_t, more=Py_ssize_t)
    cdef bint _make_room(self, Py_ssize_t max_samples) except -1
    @cython.locals(samples=samples_ptr, head=Py_ssize_t, alive=Py_ssize_t, first=Py_ssize_t,
                   stamps='long long[::1]', poses='double[::1]', parents=list)
    cdef _move(self, Py_ssize_t capacity, Py_ssize_t room)
    cdef _set_columns(self, long long[::1] stamps, double[::1] poses, Py_ssize_t capacity)

cdef _name_of(History parent)

@cython.final
cdef class Path:
    cdef readonly History target, source
    cdef readonly list up, down
    cdef object asked_target, asked_source
    cdef readonly long long topology
    cdef pose_t pose
    cdef Py_ssize_t turn, count
    cdef unsigned long long[::1] addresses
    cdef samples_t** steps

    @cython.locals(history=History, i=Py_ssize_t)
    cdef _set_steps(self, list histories)
    cpdef list edges(self)
    @cython.locals(history=History, top=History)
    cpdef list names(self)
    @cython.locals(i=Py_ssize_t, mixed=cython.bint)
    cpdef bint is_mixed(self) noexcept nogil
    @cython.locals(i=Py_ssize_t, newest=cython.longlong, latest=cython.longlong)
    cpdef long long latest(self) noexcept
    cdef bint follow(self, long long stamp_ns, bint screw) noexcept nogil
    @cython.locals(samples=samples_ptr, former=samples_ptr, i=Py_ssize_t, ratio=double,
                   pose=pose_t, step=pose_t)
    cdef bint follow_into(self, pose_t* poses, long long stamp_ns, bint screw) noexcept nogil
    @cython.locals(history=History, beyond=cython.longlong, screw=cython.bint)
    cdef long long follow_as(self, long long stamp_ns, sampling) except *

@cython.locals(pose=pose_t, step=pose_t)
cpdef pose_t chained(list up, list down) except *
cpdef bint seek_as(History history, long long stamp_ns, sampling) except -1
