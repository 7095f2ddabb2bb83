"""The visual map's file: its format, object models and landmarks; knows no bus."""
