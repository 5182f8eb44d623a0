cimport cython
cimport libc.math as math
from tfbus.geometry cimport packed
from tfbus.geometry.packed cimport octets_t, pose_t
from tfbus.geometry.columns cimport Columns

cdef Py_ssize_t EDGE_SIZE, STAMP_SIZE, POSE_SIZE, _BYTES_OF_KIND, _BYTES_OF_ROW, _MOST_BYTES, _MOST_BYTES_A_NUMBER
cdef int _HAS_ROTATION, _SHORT, _WHOLE
cdef Py_ssize_t _ROTATION_SIZE, _SHORT_SIZE
cdef double _STEP_M, _STEPS_A_METRE, _FARTHEST_M, _LARGEST_M
cdef double _STEPS_A_UNIT, _SAME_ROTATION, _LARGEST_NORM_ERROR, _LARGEST_SHORT, _NAN
cdef long long _MIDDLE, _LARGEST_OF_2, _LARGEST_OF_3

@cython.final
cdef class NumberedRows:
    cdef readonly tuple frames
    cdef readonly bytes edges, origins
    cdef readonly Py_ssize_t count, unnamed
    cdef readonly list known

    @cython.locals(count=Py_ssize_t, unpacked=bytes, columns=Columns)
    cpdef Columns columns(self, bytes stamps, bytes forms, bytes poses)

@cython.final
cdef class FrameNumbers:
    cdef readonly object epoch_ns, next_number
    cdef dict _named, _kinds
    cdef list _ascending
    cdef Py_ssize_t _bytes
    cdef object _lock

    cpdef NumberedRows get(self, bytes runs)

@cython.locals(forms=bytearray, room=bytearray, forms_at=cython.p_uchar, room_at=cython.p_uchar, at=Py_ssize_t, i=Py_ssize_t,
               pose=pose_t, origin=pose_t, form=cython.int)
cpdef tuple pack_poses(bytes poses, Py_ssize_t count, bytes origins, bint is_short)
@cython.locals(made=bytes, poses=cython.p_double, end=Py_ssize_t, size=Py_ssize_t, wanted=Py_ssize_t, at=Py_ssize_t, i=Py_ssize_t,
               row=Py_ssize_t, origin=pose_t)
cpdef bytes unpack_poses(bytes forms, bytes data, bytes origins, Py_ssize_t count, list known=*)
@cython.locals(axis=Py_ssize_t, size=Py_ssize_t)
cdef Py_ssize_t _size_of(int form) noexcept nogil
cdef int _pack_whole(unsigned char* room, Py_ssize_t at, pose_t pose) noexcept nogil
@cython.locals(x=cython.double, y=cython.double, z=cython.double)
cdef int _pack_short(unsigned char* room, Py_ssize_t at, pose_t pose, pose_t origin) noexcept nogil
@cython.locals(x=cython.double, y=cython.double, z=cython.double, farthest=cython.double, error=cython.double, size=Py_ssize_t,
               form=cython.int, scale=cython.double, qx=cython.double, qy=cython.double, qz=cython.double, qw=cython.double,
               cosine=cython.double, first=cython.longlong, second=cython.longlong, third=cython.longlong, most=cython.longlong)
cdef int _pack_compact(unsigned char* room, Py_ssize_t at, pose_t pose, pose_t origin) noexcept nogil
@cython.locals(qx=cython.double, qy=cython.double, qz=cython.double, qw=cython.double)
cdef double _norm_error(pose_t pose) noexcept nogil
@cython.locals(a=cython.double, b=cython.double, c=cython.double, largest=cython.double, place=cython.longlong, unit=cython.double,
               first=cython.longlong, second=cython.longlong, third=cython.longlong)
cdef long long _rotation_bits(double qx, double qy, double qz, double qw) noexcept nogil
@cython.locals(i=Py_ssize_t, axis=Py_ssize_t, size=Py_ssize_t, bits=cython.longlong, a=cython.double, b=cython.double,
               c=cython.double, square=cython.double, largest=cython.double, place=cython.int)
cdef void _unpack(double* poses, Py_ssize_t row, int form, octets_t data, Py_ssize_t at, pose_t origin) noexcept nogil
