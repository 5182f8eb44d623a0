"""The last seconds of every frame: inserts, lookups, waiting, reasons."""
