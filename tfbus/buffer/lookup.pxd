cimport cython
from tfbus.buffer.store cimport Store
from tfbus.geometry.batch_lookup cimport fill
from tfbus.geometry.kernel cimport Path
from tfbus.geometry.transform cimport TransformStamped

cdef Py_ssize_t _CHUNK

@cython.final
cdef class Lookup:
    cdef Store _store
    cdef tuple _questions
    cdef object _sampling, _fresh

    cpdef list answers(self)
    cpdef watch(self, waiter)
    cpdef error(self)
    cdef _answers_or_error(self)
    @cython.locals(question=tuple)
    cdef _ask(self, now_ns)
    cdef _why_not(self, failed)

cpdef lookup_many(Store store, target_frame, source_frame, stamps, sampling)
@cython.locals(path=Path, start=Py_ssize_t, before=Py_ssize_t, stop=Py_ssize_t, i=Py_ssize_t,
               j=Py_ssize_t, count=Py_ssize_t, strict=cython.bint, screw=cython.bint,
               answer=TransformStamped)
cdef _fill_chunks(
    Store store, target_frame, source_frame, const long long[::1] stamps, const int[::1] rows,
    double[::1] xyz, double[::1] quat, unsigned char[::1] known, sampling)
@cython.locals(count=Py_ssize_t, stop=Py_ssize_t)
cdef Py_ssize_t _fill_along(
    Store store, Path path, const long long[::1] stamps, const int[::1] rows, Py_ssize_t start,
    double[::1] xyz, double[::1] quat, unsigned char[::1] known, bint screw) except -1 nogil
cdef _check_connected(Store store, target_frame, source_frame, stamps)
@cython.locals(pose=tuple, k=Py_ssize_t)
cdef _write_row(TransformStamped answer, Py_ssize_t i, double[::1] xyz, double[::1] quat,
                unsigned char[::1] known)
