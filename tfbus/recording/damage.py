"""The unreadable parts of a file, and the words for them."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from tfbus.wire.limits import size_text


@dataclass(frozen=True)
class Damage:
    """Bytes of a file that cannot be read: from `offset` on, `size` bytes; the log times of their
    messages and how many there are, None if the file does not say.

    With `what`, as "topic 'pose'", it is messages that are whole, but are not what their channel
    says.
    """

    offset: int
    size: int
    reason: str
    from_ns: int | None = None
    to_ns: int | None = None
    messages: int | None = None
    what: str = ""

    def text(self, start_ns: int | None = None) -> str:
        """The damaged parts, with times since the beginning of the recording: `128 kB with 98
        messages from +3.21s to +3.44s`; in UTC if that is None.
        """
        found = f"messages of {self.what}" if self.what else size_text(self.size)
        if self.messages is not None and not self.what:
            found += f" with {self.messages:,} message{'' if self.messages == 1 else 's'}"
        if self.from_ns is None or self.to_ns is None or start_ns == 0:
            return found
        begin, end = (time_text(log_ns, start_ns) for log_ns in (self.from_ns, self.to_ns))
        return f"{found} at {begin}" if begin == end else f"{found} from {begin} to {end}"


def time_text(log_ns: int, start_ns: int | None) -> str:
    """A log time since the beginning of the recording, or in UTC."""
    if start_ns is None:
        return f"{datetime.fromtimestamp(log_ns / 1e9, UTC):%Y-%m-%dT%H:%M:%S.%f}"[:-4] + "Z"
    if log_ns < start_ns:
        return f"{(start_ns - log_ns) / 1e9:.2f}s before the beginning"
    return f"+{(log_ns - start_ns) / 1e9:.2f}s"


def united(damage: Iterable[Damage]) -> list[Damage]:
    """Damage in the order of the file; what lies side by side as one."""
    found: list[Damage] = []
    for each in sorted(damage, key=lambda one: (bool(one.what), one.offset)):
        last = found[-1] if found and not each.what else None
        if last is None or last.what or each.offset > last.offset + last.size:
            found.append(each)
            continue
        end = max(last.offset + last.size, each.offset + each.size)
        times = [time for time in (last.from_ns, last.to_ns, each.from_ns, each.to_ns) if time]
        counts = [count for count in (last.messages, each.messages) if count is not None]
        found[-1] = replace(
            last,
            size=end - last.offset,
            from_ns=min(times, default=None),
            to_ns=max(times, default=None),
            messages=sum(counts) if len(counts) == 2 else None,
        )
    return found
