cimport cython
from tfbus.buffer.lock cimport Lock
from tfbus.buffer.lookup cimport Lookup
from tfbus.buffer.store cimport Store
from tfbus.geometry.kernel cimport Path
from tfbus.geometry.columns cimport Columns, columns_of_batch
from tfbus.geometry.transform cimport TransformStamped

cdef object TF2, _AT_ONCE
cdef long long ALL_STATIC, LONGEST_NS, NO_DATA

cdef class Buffer:
    cdef readonly double cache_time_s
    cdef readonly object sampling
    cdef readonly Store _store
    cdef object __weakref__

    cdef _fill(self, cache_time_s, sampling, clock, max_samples)
    @cython.locals(answer=TransformStamped)
    cdef TransformStamped _lookup_plain(self, target_frame, source_frame, stamp_ns, timeout_s)
    cdef TransformStamped _answer(self, target_frame, source_frame, stamp_ns, sampling)
    cdef _lookup(
        self, target_frame, source_frame, stamp_ns, timeout_s, sampling, max_age_s, living)

cdef Columns _columns(batch)
@cython.locals(buffer=Buffer)
cpdef _unpickled(kind, contents, bint is_ended)
