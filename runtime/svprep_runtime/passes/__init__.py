"""The passes of a frame: state, program and buffers, one file each."""
