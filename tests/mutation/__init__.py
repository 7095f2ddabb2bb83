"""Deliberate faults in the code of the product, and which test catches each of them."""
