cimport cython

cdef extern from *:
    """
    #ifdef Py_GIL_DISABLED
    #define TFBUS_HAS_GIL 0
    #else
    #define TFBUS_HAS_GIL 1
    #endif
    /* Read while another thread may write. */
    #define tfbus_is_set(flag) (*(volatile int*) &(flag))
    #define tfbus_holder(owner) (*(volatile unsigned long*) &(owner))
    """
    const int TFBUS_HAS_GIL
    bint tfbus_is_set(int flag) noexcept nogil
    unsigned long tfbus_holder(unsigned long owner) noexcept nogil

cdef extern from "pythread.h":
    unsigned long PyThread_get_thread_ident() noexcept nogil

cdef unsigned long _PASSED

@cython.final
cdef class Gate:
    cdef cython.pymutex mutex
    cdef bint passed

@cython.final
cdef class Lock:
    cdef unsigned long _owner
    cdef Py_ssize_t _depth
    cdef int _wanted
    cdef bint _disturbed
    cdef cython.pymutex _mutex
    cdef list _queue, _later
    cdef object _settle, __weakref__

    cdef bint enter(self) except -1
    cdef int leave(self) except -1
    cdef bint is_mine(self) noexcept
    # Whether what runs nothing of Python may read without entering: the GIL keeps others out, and
    # no thread has let go of it in the middle of a change.
    cdef inline bint is_free(self) noexcept:
        return TFBUS_HAS_GIL and not self._owner
    cdef int let_others(self) except -1 nogil
    @cython.locals(gate=Gate)
    cdef int _wait(self) except -1
    @cython.locals(gate=Gate)
    cdef int _wake(self) except -1
    @cython.locals(gate=Gate)
    cdef int _pass_on(self) except -1
    cdef int _release(self) except -1
    cdef int _leave_disturbed(self) except -1
