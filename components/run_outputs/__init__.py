"""What a run leaves: the recorder (an MCAP file) and the report (its summary, tables, pictures)."""
