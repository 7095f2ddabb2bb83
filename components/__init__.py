"""Task components and drivers, one folder each; they meet on the bus alone."""
