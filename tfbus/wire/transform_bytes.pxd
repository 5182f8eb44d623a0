cimport cython
from tfbus.geometry cimport packed
from tfbus.geometry.packed cimport octets_t
from tfbus.geometry.columns cimport Columns, columns_of_batch
from tfbus.geometry.transform cimport TransformStamped, child_name
from tfbus.wire.numbered cimport FrameNumbers, NumberedRows, pack_poses

cdef Py_ssize_t EDGE_SIZE, STAMP_SIZE, POSE_SIZE, _MOST_TABLES, _LARGEST_TABLE, _MOST_NAMES, _MOST_BYTES
cdef Py_ssize_t _MOST_NAMES_OF_A_MESSAGE
cdef int _V, _EPOCH, _SEQ, _STAMPS, _POSES, _FRAMES, _EDGES, _RUNS, _FORMS
cdef int _NEEDED, _ALLOWED, _NEEDED_NUMBERED, _ALLOWED_NUMBERED
cdef long long _VERSION, _NUMBERED
cdef unsigned long long _LARGEST

@cython.final
cdef class TransformMessage:
    cdef readonly Columns rows
    cdef readonly object epoch_ns, seq
    cdef readonly Py_ssize_t unnamed

@cython.final
cdef class NameTables:
    cdef readonly dict names
    cdef Py_ssize_t _count, _bytes
    cdef object _lock

@cython.final
cdef class _Cursor:
    cdef bytes payload
    cdef octets_t data
    cdef Py_ssize_t at, end
    cdef bint failed

    @cython.locals(start=Py_ssize_t)
    cdef Py_ssize_t skip(self, Py_ssize_t size) noexcept
    @cython.locals(start=Py_ssize_t)
    cdef unsigned long long number(self, Py_ssize_t size) noexcept
    @cython.locals(start=Py_ssize_t)
    cdef int head(self) noexcept
    @cython.locals(head=cython.int)
    cdef Py_ssize_t map_length(self) noexcept
    @cython.locals(head=cython.int)
    cdef Py_ssize_t array_length(self) noexcept
    @cython.locals(head=cython.int)
    cdef Py_ssize_t text_size(self) noexcept
    @cython.locals(head=cython.int)
    cdef Py_ssize_t binary_size(self) noexcept
    @cython.locals(head=cython.int, number=cython.ulonglong)
    cdef long long integer(self) noexcept
    cdef int fail(self) noexcept

@cython.locals(cursor=_Cursor, columns=Columns, message=TransformMessage, edges_size=Py_ssize_t, stamps_size=Py_ssize_t,
               poses_size=Py_ssize_t, count=Py_ssize_t, seen=cython.int, key=cython.int)
cpdef TransformMessage scan_message(bytes payload, NameTables tables, FrameNumbers numbers=*)
@cython.locals(message=TransformMessage)
cdef TransformMessage _message(Columns rows)
@cython.locals(cursor=_Cursor, seen=cython.int, key=cython.int, start=Py_ssize_t, runs=bytes, stamps=bytes, forms=bytes,
               poses=bytes, columns=Columns, rows=NumberedRows, message=TransformMessage)
cdef TransformMessage _scan_numbered(bytes payload, FrameNumbers numbers)
cdef bytes _stamps(_Cursor cursor)
@cython.locals(size=Py_ssize_t, start=Py_ssize_t)
cdef bytes _binary(_Cursor cursor)
@cython.locals(size=Py_ssize_t, at=Py_ssize_t)
cdef int _key(_Cursor cursor) noexcept
@cython.locals(start=Py_ssize_t, count=Py_ssize_t, table=bytes, names=tuple)
cdef tuple _names(_Cursor cursor, NameTables tables)
@cython.locals(size=Py_ssize_t, texts=list)
cdef tuple _texts(_Cursor cursor, Py_ssize_t start)
@cython.locals(i=Py_ssize_t, known=Py_ssize_t, parent=Py_ssize_t, child=Py_ssize_t,
               edges=octets_t)
cdef bint _are_edges(Columns columns, Py_ssize_t count) except -1

@cython.final
cdef class OneMessage:
    cdef str _frame_id, _child_frame_id
    cdef bytes _head, _stamps, _poses

    cpdef bytes encode_bytes(self, object seq, tuple frames, long long stamp_ns, bytes pose)
    cpdef bytes encode(self, object seq, TransformStamped transform)

@cython.final
cdef class OneNumbered:
    cdef str _frame_id, _child_frame_id
    cdef bytes _head, _stamps, _forms, _poses, _origin
    cdef bint _is_short
    cdef object _pack
    cdef dict _between

    cpdef encode_bytes(self, object seq, tuple frames, long long stamp_ns, bytes pose)
    cpdef encode(self, object seq, TransformStamped transform)
    @cython.locals(form=bytes, short=bytes, between=bytes)
    cdef _message(self, object seq, long long stamp_ns, bytes pose)
