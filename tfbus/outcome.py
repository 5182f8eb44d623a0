"""Numbers by which the parts of the kernel tell each other how something ended.

Plain numbers, so that each compiled module can hold them as C numbers of its own.
"""

# What became of a sample.
KEPT = 0
TOO_OLD = 1
REPEATED = 2
CONFLICT = 3

# Answers to a question for the latest stamp; no sample has such stamps.
NO_DATA = -(2**63)
ALL_STATIC = 2**63 - 1

# As far as stamps may be from 1970, and so as long as a cache can be: differences fit 64 bits.
LONGEST_NS = 2**62
