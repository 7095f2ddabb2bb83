"""Tests that run in the guest, on its kernel's drivers."""
