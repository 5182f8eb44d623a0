"""Options of `ros2 bag record` that are not needed here, or have another name."""

_NO_SERVICES = "services and actions are not recorded"
_COMPRESSION = "use --compression zstd, lz4 or none"
_NO_THREADS = "not needed: compression takes part of one thread; --compression none takes none"

OF_RECORD = {
    "--services": _NO_SERVICES,
    "--all-services": _NO_SERVICES,
    "--exclude-services": _NO_SERVICES,
    "--actions": _NO_SERVICES,
    "--all-actions": _NO_SERVICES,
    "--exclude-actions": _NO_SERVICES,
    "--topic-types": "use --topics with what tfbus topic find TYPE prints",
    "--exclude-topic-types": "use --exclude-topics with what tfbus topic find TYPE prints",
    "--static-topics-path": "use --topics; they need not be there yet",
    "--include-unpublished-topics": "not needed: topics that nodes only subscribe to are recorded",
    "--include-hidden-topics": "not needed: no topic is hidden",
    "--ignore-leaf-topics": "use --exclude-topics",
    "--no-discovery": "use --topics for those that are there now",
    "--polling-interval": "not needed: nodes tell of their topics",
    "-p": "not needed: nodes tell of their topics",
    "--qos-profile-overrides-path": "not needed: there is no QoS",
    "--serialization-format": "messages are always in CDR",
    "-f": "messages are always in CDR",
    "--snapshot-mode": "use --snapshot SECONDS",
    "--max-cache-duration": "use --snapshot SECONDS",
    "--use-sim-time": "not needed: stamps are recorded as they are, and the topic clock",
    "--repeat-transient-local": "not needed: static transforms are in each file, every 5 s",
    "--compression-mode": _COMPRESSION,
    "--storage-preset-profile": _COMPRESSION,
    "--storage-config-file": _COMPRESSION,
    "--compression-queue-size": _NO_THREADS,
    "--compression-threads": _NO_THREADS,
    "--compression-threads-priority": _NO_THREADS,
    "--stats_max_publishing_rate": "what is lost is in the status line, the log and the file",
}
