"""What other programs call a block - cameras, poses, points - to and from the values of `model`.

Pure functions on text and values: readers in `ingest` and exporters open the files.
"""
