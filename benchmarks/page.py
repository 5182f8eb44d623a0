"""docs/reference/performance.md, written by the benchmark."""

from collections.abc import Mapping, Sequence

from benchmarks import growth, report
from benchmarks.growth import Curve
from benchmarks.measure import Result

_PAGE = """\
# How fast the buffer is

`make bench` measured this and wrote this page. The numbers are of one machine and differ on others,
so look at the ratios. {place}

{versions}

## Beside its peers

The ratio is what the peer takes over what tfbus takes: above one, tfbus is faster (or smaller). *At
least* is our goal.

{table}

All have the same chains of frames: 100 Hz, 1,000 samples an edge, poses that swing, stamps of
today. Lookups go from end to end of a chain and interpolate on every edge, at stamps scattered over
the last tenth of a second, as in most robots, unless the row says 10 s. Each peer is a process of
its own, warmed up; those in one group of rows take turns, so that a busy moment of the machine hits
all, and a number is the median of their runs. All numbers of Python include the loop in Python.

What differs:

- tf2 from C++ is called from C++, with strings made in advance; all others from Python.
- transform-tree has a fixed topology, one writer an edge, and refuses samples out of order; its
  plan is compiled in advance and needs no names; its latest is by plan, too. It and pytransform3d
  answer with matrices, all others with a translation and a quaternion.
- schiebung's latest is the newest of each edge, which need not be of one time.
- pytransform3d takes whole series, so it has no insert; it interpolates along screws.
- Inserts are timed with messages, transforms or arrays made in advance, 5,000 transforms at a time,
  so that they are in the processor's caches like what has just arrived; with as many as fit into
  50 ms, a faster peer would have to fetch more of them from memory. The names in columns are the
  same texts each time. transform-tree has columns of one edge only, so 50 edges are 50 calls, as
  with tf2.
- Many stamps in one call are the same ones from call to call, as many calls as fill 50 ms.
- Beside inserts: another thread of the same process inserts 2,000 batches of 50 a second; the peer
  is tfbus alone.
- Memory is the growth of the process, with a million samples over 100 edges.
- The interpreted kernel is the same source without a C compiler.

{left_out}

Times of a busy machine vary; `python -m benchmarks.instructions "lookup 3"` counts the instructions
instead, under valgrind.

## Where the time goes

- A lookup of three edges takes about 170 ns: 85 for the call, the names and the answer, and 28 for
  each edge, which is a search that mostly guesses right, a slerp by a series, and a product. With a
  GIL it does not enter a free lock. Edges of one publisher mostly have the same stamps in the same
  places: then only the first of them is searched, and all share its ratio.
- An answer is one object of 96 bytes, which the garbage collector does not track. Answers that are
  kept need new memory, whose pages the system has to clear; the peers' do too, so that ratios are
  lower than in the table, whose answers are dropped. By CPU time, three edges, the best of many
  runs in turns: 3.1 x schiebung and 4.6 x transform-tree on Python 3.13, 3.3 x and 5.4 x on 3.12,
  5.4 x transform-tree on 3.11.
- The latest needs neither search nor slerp where the newest samples of all edges have one time:
  10 ns an edge.
- Samples are in rings, so that nothing moves when they are added and removed. The history of 50
  edges is 3.7 MB, more than the processor's nearer caches hold, and each row is written to another
  part of it. In a profile 58 % of the loop over the rows was at the first store that had to wait
  for earlier stores; so the slot of the next sample is fetched while this one is written, which
  made columns of 50 edges take 66 ns a row instead of 92.
- The loop over the rows is in the module of what it calls, so that all of it is compiled as one and
  no pose passes from function to function: 40 ns a row instead of the 51 of that time, with the
  rows in the caches. About 10 of them are the copy of a batch's arrays (most of it the calls),
  which messages from the bus do not need. The names of the frames are compared with those of the
  batch before, unless they are the same texts, as from the bus, and here.
- Many stamps go edge by edge through blocks of 64. What two samples have in common is computed
  once, which makes sorted stamps twice as fast (41 ns each instead of 87, for three edges). Random
  stamps are first put roughly in order, which takes 6 ns each (a full sort would take 46); so they
  cost 52 ns each, and 93 without it.

These are times of the processor, of one thread of an EPYC on Python 3.13, the least of many runs;
the table above has the whole, measured now.

## How it grows

![The time of one lookup by depth, number of frames and number of samples](performance.svg)

{curves}
"""


def performance(
    results: Sequence[Result], curves: Sequence[Curve], place: str, versions: Mapping[str, str]
) -> str:
    """The whole page."""
    missing = report.left_out(results)
    return _PAGE.format(
        place=place,
        versions="\n".join(f"- {peer}: {version}" for peer, version in versions.items()),
        table=report.as_markdown(results),
        left_out="Left out:\n\n" + "\n".join(f"- {line}" for line in missing) if missing else "",
        curves="\n\n".join(
            f"{curve.axis.title}:\n\n{growth.as_markdown(curve)}" for curve in curves
        ),
    )
