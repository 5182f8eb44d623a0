"""The bus measured: intake, latency, startup, growth; a section of docs/performance.md."""
