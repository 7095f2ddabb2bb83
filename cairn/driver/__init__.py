"""What drivers of devices share: lines to them, threads, clocks, diagnostics, emulated devices."""
