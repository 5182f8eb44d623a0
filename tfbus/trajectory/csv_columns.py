"""The columns of a pose in CSV, as `tfbus echo --format csv` writes them."""

FRAME_COLUMNS = ("frame_id", "child_frame_id")
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
CSV_COLUMNS = ("stamp_ns", *FRAME_COLUMNS, *POSE_COLUMNS, "roll", "pitch", "yaw")
