"""Deliberate faults in the product code, and which test catches each of them."""
