"""Limits that the command line shows before it imports anything heavy."""

MAX_GIGABYTES = 4.0  # [1e9 bytes], largest unpacked size of a file
