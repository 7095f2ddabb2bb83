"""Certificate authority, identities and roster of a robot whose parts run on several machines.

Only `certificates` and the modules that use it import the library `cryptography`, so that
processes that merely read these files do not pay for it.
"""
