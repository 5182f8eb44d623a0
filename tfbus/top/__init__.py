"""The whole bus on one screen: nodes, streams, frames and topics, live."""
