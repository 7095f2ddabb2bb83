"""Tests on the kernel's own drivers, in a virtual machine: `make test-hardware`."""
