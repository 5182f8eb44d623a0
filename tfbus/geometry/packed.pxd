# The functions of packed.py in C, inlined into the modules that cimport them; packed.py itself is
# not compiled.

from cpython cimport array
from cpython.bytearray cimport PyByteArray_AS_STRING
from cpython.bytes cimport PyBytes_AS_STRING, PyBytes_FromStringAndSize
from cpython.long cimport PyLong_AsLongLongAndOverflow
from cpython.sequence cimport PySequence_Fast_ITEMS
from cpython.unicode cimport PyUnicode_DecodeUTF8
from libc.limits cimport LLONG_MIN
from libc.math cimport floor
from libc.string cimport memcmp, memcpy

ctypedef (double, double, double, double, double, double, double) pose_t
ctypedef (unsigned int, unsigned int) edge_t
ctypedef const unsigned char* octets_t


cdef extern from *:
    """
    #ifdef __GNUC__
    #define tfbus_prefetch(place) __builtin_prefetch(place)
    #else
    #define tfbus_prefetch(place) ((void) (place))
    #endif
    """
    void tfbus_prefetch(const void* place) noexcept nogil


cdef inline void fetch_pose(const double* poses, Py_ssize_t at) noexcept nogil:
    # It may begin on one line of the processor's cache, and end on the next.
    tfbus_prefetch(poses + at)
    tfbus_prefetch(poses + at + 6)


cdef inline edge_t edge_at(octets_t data, Py_ssize_t at) noexcept nogil:
    cdef edge_t edge
    memcpy(&edge, data + at, 8)
    return edge


cdef inline long long stamp_at(octets_t data, Py_ssize_t at) noexcept nogil:
    cdef long long stamp
    memcpy(&stamp, data + at, 8)
    return stamp


cdef inline pose_t pose_at(octets_t data, Py_ssize_t at) noexcept nogil:
    cdef pose_t pose
    memcpy(&pose, data + at, 56)
    return pose


cdef inline long long int64(object number) except? -1:
    cdef int overflow
    cdef long long value = PyLong_AsLongLongAndOverflow(number, &overflow)
    return value if overflow == 0 else LLONG_MIN


cdef inline bytes edge_bytes(unsigned int parent, unsigned int child):
    cdef edge_t edge = (parent, child)
    return PyBytes_FromStringAndSize(<const char*> &edge, 8)


cdef inline bytes stamp_bytes(long long stamp_ns):
    return PyBytes_FromStringAndSize(<const char*> &stamp_ns, 8)


cdef inline bytes pose_bytes(pose_t pose):
    return PyBytes_FromStringAndSize(<const char*> &pose, 56)


cdef inline unsigned long long big_endian_at(
        octets_t data, Py_ssize_t at, Py_ssize_t size) noexcept nogil:
    cdef unsigned long long number = 0
    cdef Py_ssize_t i
    for i in range(at, at + size):
        number = number << 8 | data[i]
    return number


cdef inline void put(
        unsigned char* data, Py_ssize_t at, long long number, Py_ssize_t size) noexcept nogil:
    cdef unsigned long long left = <unsigned long long> number
    cdef Py_ssize_t i
    for i in range(at, at + size):
        data[i] = left & 255
        left >>= 8


cdef inline long long little_endian_at(
        octets_t data, Py_ssize_t at, Py_ssize_t size) noexcept nogil:
    cdef unsigned long long number = 0
    cdef Py_ssize_t i
    for i in range(size):
        number |= <unsigned long long> data[at + i] << (8 * i)
    if size < 8 and number >> (8 * size - 1):
        number |= <unsigned long long> -1 << (8 * size)
    return <long long> number


cdef inline long long bits_of(double number) noexcept nogil:
    cdef long long bits
    memcpy(&bits, &number, 8)
    return bits


cdef inline double float_of(long long bits) noexcept nogil:
    cdef double number
    memcpy(&number, &bits, 8)
    return number


cdef inline int short_bits_of(double number) noexcept nogil:
    cdef float near = <float> number
    cdef int bits
    memcpy(&bits, &near, 4)
    return bits


cdef inline double short_float_of(int bits) noexcept nogil:
    cdef float near
    memcpy(&near, &bits, 4)
    return near


cdef inline long long nearest(double number) noexcept nogil:
    return <long long> floor(number + 0.5)


cdef inline array.array unset(array.array like, Py_ssize_t count):
    return array.clone(like, count, zero=False)


cdef inline bytes room_for_poses(Py_ssize_t count):
    return PyBytes_FromStringAndSize(NULL, 56 * count)


cdef inline double* floats_of(bytes room) noexcept:
    return <double*> PyBytes_AS_STRING(room)


cdef inline bytes bytes_of(bytes room):
    return room


cdef inline unsigned char* octets_of(bytearray room) noexcept:
    return <unsigned char*> PyByteArray_AS_STRING(room)


cdef inline bint is_at(octets_t data, Py_ssize_t at, const char* text,
                       Py_ssize_t size) noexcept nogil:
    return memcmp(data + at, text, size) == 0


cdef inline bint are_texts(tuple some, tuple others) except -1:
    cdef Py_ssize_t count = len(some)
    if count == len(others) and memcmp(
            PySequence_Fast_ITEMS(some), PySequence_Fast_ITEMS(others), count * sizeof(void*)) == 0:
        return True
    return some == others


cdef inline str text_at(octets_t data, Py_ssize_t at, Py_ssize_t size):
    return PyUnicode_DecodeUTF8(<const char*> data + at, size, NULL)
