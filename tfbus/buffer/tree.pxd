cimport cython
from tfbus.geometry cimport packed
from tfbus.geometry.kernel cimport History
from tfbus.geometry.kernel cimport Path, seek_as
from tfbus.geometry.kernel cimport pose_t, chained, normalised
from tfbus.geometry.transform cimport Transform, TransformStamped, make_stamped

cdef object TF2
cdef Py_ssize_t _RECENT
cdef Py_ssize_t _MOST_KEPT, _PATH_COST
cdef long long ALL_STATIC, CONFLICT, CROWDED, NO_DATA, TOO_OLD

@cython.final
cdef class Tree:
    cdef long long cache_ns
    cdef readonly Py_ssize_t max_samples
    cdef readonly dict frames
    cdef list recent
    cdef object kept
    cdef readonly Py_ssize_t kept_cost
    cdef dict senders
    cdef readonly long long topology, assignments
    cdef public list touched, moved, news, crowded
    cdef public set asked
    cdef public list unreported

    @cython.locals(answer=TransformStamped, path=Path, stamp=cython.longlong,
                   beyond=cython.longlong)
    cpdef TransformStamped answer(self, target_frame, source_frame, stamp_ns, sampling)
    @cython.locals(path=Path, stamp=cython.longlong)
    cdef bint fill(
        self, TransformStamped answer, target_frame, source_frame, stamp_ns) except -1
    @cython.locals(target=History, path=Path)
    cpdef Path path(self, target_frame, source_frame)
    @cython.locals(target=History, source=History)
    cdef Path _seek_path(self, target_frame, source_frame)
    @cython.locals(asked=set)
    cdef _record_pair(self, tuple pair)
    cpdef ask_again(self)
    @cython.locals(path=Path)
    cdef Path _find_path(self, History target, History source)
    @cython.locals(oldest=Path)
    cdef _keep(self, Path path)
    @cython.locals(above=list, parent=History)
    cpdef list chain(self, History history)
    @cython.locals(target=History, source=History)
    cdef TransformStamped _answer_by_walk(
        self, target_frame, source_frame, stamp_ns, sampling)
    @cython.locals(end=History, above=History)
    cpdef list loop_above(self, str frame, long long stamp_ns, sampling)
    @cython.locals(pose=pose_t, beyond=cython.longlong, above=History)
    cdef list _walk(self, History history, long long stamp_ns, sampling)
    @cython.locals(history=History)
    cpdef info(self, frame)
    @cython.locals(history=History)
    cpdef list infos(self)
    @cython.locals(child=History, parent=History, was_static=cython.bint,
                   succeeds=cython.bint, outcome=cython.int)
    cdef bint insert(self, str parent_frame, str child_frame, long long stamp_ns, pose_t pose,
                     bint static, str authority) except -1
    @cython.locals(child=History, parent=History, after=History)
    cdef tuple _join(
        self, str parent_frame, str child_frame, long long stamp_ns, bint static, str authority)
    cdef bint _is_only_repeated(
        self, History child, str parent_frame, pose_t pose, str authority) except -1
    cdef _note_crowded(self, History child)
    @cython.locals(former=dict)
    cdef _assign(self, History child, str authority, long long stamp_ns)
    cdef _set_gone(self, History child, bint gone, str authority, long long stamp_ns)
    cdef _add(self, History history, str authority, long long stamp_ns)
    @cython.locals(history=History, other=str)
    cdef _refuse_loop(self, History parent, History child, str authority)
    @cython.locals(history=History)
    cdef History _yielding(self, list closing)
    cdef _detach(self, History history)
    @cython.locals(history=History)
    cpdef clear(self)
    @cython.locals(history=History)
    cpdef interrupt(self, str reason)
    @cython.locals(history=History)
    cpdef clear_after(self, long long stamp_ns)
    @cython.locals(history=History, sent=dict, found=list)
    cpdef dict sent_by(self, str authority, frames)
    @cython.locals(history=History, sent=dict)
    cpdef forget(self, str authority, frames)
    @cython.locals(history=History, sent=dict)
    cpdef mark_gone(self, frames, bint gone, str authority)
    @cython.locals(history=History)
    cpdef bint remove(self, str frame) except -1
    cpdef bint remove_sent(self, str frame, str authority) except -1
    @cython.locals(history=History, found=list)
    cdef list _children(self, History parent)
    cdef _report(self, str kind, History child, History parent, str authority, long long stamp_ns)

@cython.locals(latest=cython.longlong)
cdef long long _stamp_on(Path path, stamp_ns) except? -1
@cython.locals(target=cython.size_t, source=cython.size_t)
cdef Py_ssize_t _slot(target_frame, source_frame) noexcept
cdef describe(History history, list children)
cdef History _parent_at(History history, long long stamp_ns, sampling)
