"""What is measured, against what: `make bench`, or `python -m cairn_lab.benchmarks NAME...`."""
