cimport cython
from tfbus.buffer.store cimport Store

@cython.final
cdef class Lookup:
    cdef Store _store
    cdef tuple _questions
    cdef object _sampling, _fresh

    cpdef list answers(self)
    cpdef watch(self, waiter)
    cpdef error(self)
    cdef list _answers(self, tuple questions, fresh, now_ns)
    @cython.locals(store=Store)
    cdef _explained(self, reason)
    @cython.locals(store=Store)
    cdef _reason(self, now_ns)
    cdef _why_stale(self, now_ns)
    @cython.locals(store=Store)
    cdef _why_not(self, tuple question)
