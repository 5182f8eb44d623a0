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
    cdef _answers_or_error(self)
    @cython.locals(question=tuple)
    cdef _ask(self, now_ns)
    @cython.locals(store=Store)
    cdef _explained(self, reason)
    @cython.locals(store=Store)
    cdef _why_not(self, failed)
