"""The bus, or a recording, as Foxglove shows it live."""
