"""Options of `ros2 bag record` and `play` that are not needed here, or have another name."""

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

_NONE_RECORDED = "services and actions are not recorded, so none are played"

OF_PLAY = {
    "-a": "not needed: all that was recorded is played",
    "--all": "not needed: all that was recorded is played",
    "--wait-for-all-acked": "not needed: there are no acknowledgements to wait for",
    "--read-ahead-queue-size": "not needed: the player reads ahead by itself",
    "--qos-profile-overrides-path": "not needed: there is no QoS",
    "--message-order": "messages are played in the order in which they were received",
    "--use-sim-time": "use --clock, which publishes the recorded time for nodes with --sim-time",
    "--clock-topics": "use --clock, with a rate in Hz after it",
    "--clock-topics-all": "use --clock, with a rate in Hz after it",
    "--services": _NONE_RECORDED,
    "--exclude-services": _NONE_RECORDED,
    "--actions": _NONE_RECORDED,
    "--exclude-actions": _NONE_RECORDED,
    "--publish-service-requests": _NONE_RECORDED,
    "--service-requests-source": _NONE_RECORDED,
    "--send-actions-as-client": _NONE_RECORDED,
    "--burst": "use --rate with a large number, or --pause and the key . for single messages",
    "--storage-config-file": "not needed: files are read as they are",
    "--disable-loan-message": "not needed: messages are never loaned",
    "--progress-bar-update-rate": "use --quiet for no progress",
}
