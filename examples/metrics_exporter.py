"""Exports the state of a bus to Prometheus: ages, rates and delays of frames, conflicts, losses.

    python examples/metrics_exporter.py
    python examples/metrics_exporter.py --param fleet=true --param shared=map
    curl http://127.0.0.1:9464/metrics

The second one has all robots in namespaces below, as robot7/base_link, in the map that they share;
without `shared` the map of each is a tree apart, which counts as a problem. It needs `pip install
prometheus-client`. Each scrape looks at the bus once. Only programs on this machine can scrape it,
unless `--param address=0.0.0.0` is given. Ctrl-C ends it.
"""

from collections.abc import Iterator

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from tfbus import Fleet, Node
from tfbus.inspect import Watch

FRAMES = {
    "age_s": ("tfbus_frame_age_seconds", "Age of the newest stamp of a dynamic frame"),
    "rate_hz": ("tfbus_frame_rate_hertz", "Samples of a dynamic frame per second"),
    "delay_s": ("tfbus_frame_delay_seconds", "Age of a sample when it comes"),
}


class BusCollector:
    """Makes the metrics of a moment of the bus, when they are scraped."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch

    def collect(self) -> Iterator[Metric]:
        """The metrics of now."""
        moment = self._watch.now()
        labels = ["frame", "publisher"]
        for field, (name, text) in FRAMES.items():
            family = GaugeMetricFamily(name, text, labels=labels)
            for frame in moment.frames.values():
                value = getattr(frame, field)
                if value is not None:
                    family.add_metric([frame.name, frame.publisher], value)
            yield family
        gone = GaugeMetricFamily("tfbus_frame_gone", "1 if its publisher has left", labels=labels)
        for frame in moment.frames.values():
            gone.add_metric([frame.name, frame.publisher], frame.state == "gone")
        yield gone
        yield GaugeMetricFamily(
            "tfbus_conflicts", "Frames with several publishers", value=len(moment.conflicts)
        )
        problems = GaugeMetricFamily("tfbus_problems", "Problems of the tree", labels=["kind"])
        kinds = [problem.kind for problem in moment.problems]
        for kind in sorted(set(kinds)):
            problems.add_metric([kind], kinds.count(kind))
        yield problems
        yield GaugeMetricFamily("tfbus_nodes", "Nodes on the bus", value=len(moment.node_names))
        yield CounterMetricFamily("tfbus_lost", "Messages that never came", value=moment.lost)
        yield CounterMetricFamily("tfbus_refused", "Transforms rejected", value=moment.refused)


with Node.from_args("metrics_exporter") as node:
    port = node.declare_parameter("port", 9464, minimum=0, maximum=65535)
    address = node.declare_parameter("address", "127.0.0.1")
    robots = node.declare_parameter("fleet", False, description="All robots below, too.").value
    text = "Frames that all robots share, with commas."
    shared = node.declare_parameter("shared", "", description=text).value
    frames = tuple(filter(None, shared.split(",")))
    with Watch(node, fleet=Fleet(shared_frames=frames) if robots else None) as watch:
        registry = CollectorRegistry()
        registry.register(BusCollector(watch))
        server, thread = start_http_server(port.value, address.value, registry)
        print(f"http://{address.value}:{server.server_port}/metrics", flush=True)
        node.spin()
        server.shutdown()
        thread.join()
