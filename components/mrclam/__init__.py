"""Drivers and map importer for recordings of the UTIAS multi-robot (MRCLAM) data sets."""
