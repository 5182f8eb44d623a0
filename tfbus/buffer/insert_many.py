"""Inserts the rows of batches into the tree.

Compiled if there is a C compiler (`insert_many.pxd` has the C types). The buffer holds its lock
around every call, which lets others have it between rows if that takes long.
"""

from array import array

from tfbus.base.errors import InvalidArgumentException
from tfbus.buffer.info import Rejections
from tfbus.buffer.lock import Lock
from tfbus.buffer.tree import Tree
from tfbus.geometry import packed
from tfbus.geometry.columns import Columns
from tfbus.geometry.kernel import (
    LONGEST_NS,
    QUATERNION_TOLERANCE,
    UNIT_TO_THE_LAST_BIT,
    History,
    Pose,
)
from tfbus.geometry.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

if not cython.compiled:
    # Compiled, they are functions of C.
    from tfbus.geometry.kernel import append_rows, off_unit, unit

# Authorities whose last batch has its edges kept, and the fewest rows for which that pays.
_MOST_TABLES = 1024
_LEAST_ROWS = 4

# Rows that are not appended to known frames, until another thread may look up: a new frame takes
# some 10 microseconds.
_ROWS_AT_A_TIME = 256


class Permit:
    """The permission to store rows, until somebody takes it back.

    Rows that are judged before they are stored, such as of a stream's message, may be judged
    otherwise meanwhile: `is_valid` is looked at with the buffer's lock held. Take a permit back
    before removing from the buffer: no row that was judged with it is stored afterwards.
    """

    def __init__(self) -> None:
        self.is_valid = True


class Table:
    """The edges of the rows of a batch, found once for all batches of an authority with the same
    ones: `children` are the histories, row by row, and `samples` theirs.

    This authority sent all of them last, with the parents that the batch names. That holds while
    the tree has the same `topology` and `assignments`.
    """

    def __init__(
        self,
        frames: tuple[str, ...],
        edges: bytes,
        children: list[History],
        topology: int,
        assignments: int,
    ) -> None:
        self.frames = frames
        self.edges = edges
        self.children = children
        self.topology = topology
        self.assignments = assignments
        self._set_samples(children)

    def _set_samples(self, children: list[History]) -> None:
        if cython.compiled:
            self.addresses = array("Q", bytes(8 * len(children)))
            for i in range(len(children)):
                child = children[i]
                self.addresses[i] = cython.cast(cython.size_t, child.samples)
            self.samples = cython.cast("samples_t **", cython.address(self.addresses[0]))
        else:
            self.samples = [child.samples for child in children]


class BatchInserter:
    """Inserts the rows of batches into a tree; rows that cannot be stored count in `rejected`."""

    def __init__(self, tree: Tree, rejected: Rejections, lock: Lock) -> None:
        self._tree = tree
        self._rejected = rejected
        self._lock = lock
        # By authority the edges of its last batch.
        self._tables: dict[str, Table] = {}

    def insert(self, columns: Columns, static: bool, authority: str, permit: Permit | None) -> int:
        """Store the rows of a batch, while there is a permit if one is given; how many were
        stored.
        """
        if permit is not None and not permit.is_valid:
            return 0
        table = None if static else self._table(columns, authority)
        stored = at = slow = 0
        while at < columns.count:
            if table is not None and self._holds(table):
                start = at
                at = self._append(table, columns, start)
                stored += at - start
            if at < columns.count:
                stored += self._insert_row(columns, at, static, authority)
                at += 1
                slow += 1
                if slow == _ROWS_AT_A_TIME:
                    slow = 0
                    # A thread that waits for the GIL finds the lock taken, and waits for that.
                    with cython.nogil:
                        pass
                    self._lock.let_others()
                    if permit is not None and not permit.is_valid:
                        return stored
        return stored

    def _append(self, table: Table, columns: Columns, start: int) -> int:
        """Append rows from `start` on, up to the first that needs `_insert_row`; its index, or the
        count of all.
        """
        at = append_rows(
            table.samples,
            columns.stamps,
            columns.stamps_at,
            columns.poses,
            columns.poses_at,
            start,
            columns.count,
            self._tree.cache_ns,
        )
        if self._tree.touched is not None:
            self._tree.touched += table.children[start:at]
        return at

    def _insert_row(self, columns: Columns, at: int, static: bool, authority: str) -> bool:
        """Store one row; whether it was stored."""
        stamp_ns = packed.stamp_at(columns.stamps, columns.stamps_at + STAMP_SIZE * at)
        pose: Pose = packed.pose_at(columns.poses, columns.poses_at + POSE_SIZE * at)
        edge = packed.edge_at(columns.edges, columns.edges_at + EDGE_SIZE * at)
        parent, child = columns.frames[edge[0]], columns.frames[edge[1]]
        error = off_unit(pose)
        # NaN compares unequal to itself.
        if error != error:
            self._rejected.add(f"{child!r}: a number is not finite")
        elif not (error > -QUATERNION_TOLERANCE and error < QUATERNION_TOLERANCE):
            self._rejected.add(f"{child!r}: the quaternion's norm is not 1")
        elif not (stamp_ns > -LONGEST_NS and stamp_ns < LONGEST_NS):
            self._rejected.add(f"{child!r}: the stamp is not within 146 years of 1970")
        else:
            if error > UNIT_TO_THE_LAST_BIT or error < -UNIT_TO_THE_LAST_BIT:
                pose = unit(pose, error)
            try:
                return self._tree.insert(parent, child, stamp_ns, pose, static, authority)
            except InvalidArgumentException as reason:
                self._rejected.add(str(reason))
        return False

    def _holds(self, table: Table) -> bool:
        return table.topology == self._tree.topology and table.assignments == self._tree.assignments

    def _table(self, columns: Columns, authority: str) -> Table | None:
        """The edges of a batch; None if one of them is not in the tree as named, or has another
        publisher.
        """
        table = self._tables.get(authority)
        if table is not None and self._holds(table) and columns.is_like(table.frames, table.edges):
            return table
        return self._find_table(columns, authority) if columns.count >= _LEAST_ROWS else None

    def _find_table(self, columns: Columns, authority: str) -> Table | None:
        children = []
        for i in range(columns.count):
            edge = packed.edge_at(columns.edges, columns.edges_at + EDGE_SIZE * i)
            child = self._tree.frames.get(columns.frames[edge[1]])
            parent = None if child is None else child.parent
            if (
                child is None
                or parent is None
                or parent.name != columns.frames[edge[0]]
                or child.authority != authority
            ):
                return None
            children.append(child)
        edges = columns.edges[columns.edges_at : columns.edges_at + EDGE_SIZE * columns.count]
        table = Table(columns.frames, edges, children, self._tree.topology, self._tree.assignments)
        if len(self._tables) >= _MOST_TABLES:
            self._tables.clear()
        self._tables[authority] = table
        return table
