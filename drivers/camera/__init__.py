"""Cameras over GenICam, each in a worker process of its own: the vendor's GenTL producer, or Aravis.

The GenTL binding holds the interpreter lock while it waits, and a vendor's library may hang or crash: so
`camera` (in the program) and `worker` (in its own process) share nothing but a socket pair (`channel`) and a
ring of frames in memory (`ring`).
"""
