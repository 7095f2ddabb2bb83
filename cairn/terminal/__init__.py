"""What commands share on a terminal: options, their completion, output, plots of characters."""
