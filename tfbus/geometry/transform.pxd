cimport cython
from tfbus.geometry.kernel cimport (
    pose_t, relative, lerp_slerp, sclerp, compose, exp_twist, invert, log_pose, normalised
)

@cython.final
cdef class Transform:
    cdef pose_t _pose

    cpdef pose_t as_pose(self) noexcept

@cython.final
cdef class TransformStamped:
    cdef str _frame_id
    cdef object _child
    cdef pose_t _pose
    cdef long long _stamp_ns

cpdef str child_name(TransformStamped transform)

@cython.locals(self=Transform)
cpdef Transform make_transform(pose_t pose)

@cython.locals(motion=Transform)
cdef pose_t pose_of(transform) except *

cpdef Transform checked_transform(value, str what=*)

@cython.locals(self=TransformStamped)
cpdef TransformStamped make_stamped(
    long long stamp_ns, str frame_id, str child_frame_id, pose_t pose, long long extrapolated_ns)
