"""The rows of a batch, taken into the tree.

One of the modules that are compiled where there is a C compiler (`intake.pxd` says the C types).
Nothing here locks: the buffer holds its lock around every call.
"""

from array import array

from tfbus.buffer.info import Rejections
from tfbus.buffer.tree import Tree
from tfbus.core import packed
from tfbus.core.kernel import History, Pose
from tfbus.core.outcome import LONGEST_NS, QUATERNION_TOLERANCE, UNIT_TO_THE_LAST_BIT
from tfbus.core.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.columns import Columns

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

if not cython.compiled:
    # Compiled, they are functions of C.
    from tfbus.core.kernel import append_rows, off_unit, unit

# Of so many authorities the edges of the last batch are kept; of fewer rows it is not worth it.
_MOST_TABLES = 1024
_LEAST_ROWS = 4


class Table:
    """The edges of the rows of a batch, found once for all batches of an authority that name the
    same ones: `children` are the histories, row by row, and `samples` what is appended to.

    All of them were sent last by this authority, from the parents that the batch names. That
    holds while `topology` and `assignments` are those of the tree.
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
    """Takes the rows of batches into a tree; those that cannot be taken are counted in
    `rejected`.
    """

    def __init__(self, tree: Tree, rejected: Rejections) -> None:
        self._tree = tree
        self._rejected = rejected
        # Of each authority what its last batch named.
        self._tables: dict[str, Table] = {}

    def insert(self, columns: Columns, static: bool, authority: str) -> int:
        """Take the rows of a batch; how many were taken."""
        table = None if static else self._table(columns, authority)
        taken = at = 0
        while at < columns.count:
            if table is not None and self._holds(table):
                start = at
                at = self._append(table, columns, start)
                taken += at - start
            if at < columns.count:
                taken += self._insert_row(columns, at, static, authority)
                at += 1
        return taken

    def _append(self, table: Table, columns: Columns, start: int) -> int:
        """Take rows from `start` on, as long as each is newer than the others of its edge and
        nothing changes but that: the row at which it is not so, or the count of all.
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
        """Take one row; whether it was taken."""
        stamp_ns = packed.stamp_at(columns.stamps, columns.stamps_at + STAMP_SIZE * at)
        pose: Pose = packed.pose_at(columns.poses, columns.poses_at + POSE_SIZE * at)
        edge = packed.edge_at(columns.edges, columns.edges_at + EDGE_SIZE * at)
        parent, child = columns.frames[edge[0]], columns.frames[edge[1]]
        error = off_unit(pose)
        # What is not a number is no less than anything.
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
        """The edges of a batch; None where not all of them are known as they are named, or one
        of them was sent by another.
        """
        size = EDGE_SIZE * columns.count
        table = self._tables.get(authority)
        if (
            table is not None
            and self._holds(table)
            and len(table.edges) == size
            and packed.is_at(columns.edges, columns.edges_at, table.edges, size)
            and (table.frames is columns.frames or table.frames == columns.frames)
        ):
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
