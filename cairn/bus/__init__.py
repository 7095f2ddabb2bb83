"""The bus: topics and control requests between components, over Zenoh or in memory."""
