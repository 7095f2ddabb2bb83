"""The bus: topics, messages and control between components, over Zenoh or in lockstep."""
