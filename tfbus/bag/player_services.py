"""The services of a player's node, by which other programs pause it, seek, and so on."""

from collections.abc import Callable

from tfbus.bag.player import Player
from tfbus.errors import InvalidArgumentException, ServiceError
from tfbus.messages import Empty, PlayNext, PlayProgress, Seek, SetRate
from tfbus.node.node import Node


def serve(node: Node, player: Player, stop: Callable[[], object]) -> None:
    """Serve `~/pause`, `resume`, `toggle_paused`, `play_next`, `seek`, `set_rate`, `progress` and
    `stop`, which calls `stop()`.
    """

    def done_by(job: Callable[[], object]) -> Callable[[Empty.Request], Empty.Response]:
        def handle(request: Empty.Request) -> Empty.Response:
            job()
            return Empty.Response()

        return handle

    def set_rate(request: SetRate.Request) -> SetRate.Response:
        try:
            player.set_rate(request.rate)
        except InvalidArgumentException as error:
            raise ServiceError(str(error)) from error
        return SetRate.Response()

    def play_next(request: PlayNext.Request) -> PlayNext.Response:
        player.step(request.messages)
        return PlayNext.Response()

    def seek(request: Seek.Request) -> Seek.Response:
        base_ns = request.log_ns or player.progress.start_ns
        player.seek(base_ns + round(request.offset_s * 1e9))
        progress = player.progress
        return Seek.Response(progress.log_ns, progress.played_s)

    def progress(request: PlayProgress.Request) -> PlayProgress.Response:
        now = player.progress
        return PlayProgress.Response(
            now.log_ns, now.start_ns, now.end_ns, now.rate, now.is_paused, now.sent, now.loops
        )

    node.create_service(Empty, "~/pause", done_by(player.pause))
    node.create_service(Empty, "~/resume", done_by(player.resume))
    node.create_service(Empty, "~/toggle_paused", done_by(player.toggle_paused))
    node.create_service(Empty, "~/stop", done_by(stop))
    node.create_service(SetRate, "~/set_rate", set_rate)
    node.create_service(PlayNext, "~/play_next", play_next)
    node.create_service(Seek, "~/seek", seek)
    node.create_service(PlayProgress, "~/progress", progress)
