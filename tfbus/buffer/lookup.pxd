from tfbus.buffer.store cimport Store

cdef class Answering(Store):
    cpdef _watch(self, waiter, questions, fresh=*)
    cpdef _why_stale(self, questions, fresh)
