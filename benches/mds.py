"""Peer of benches/geometry.rs: scikit-learn's MDS on distances. Reads a file of matrices (blank line between), prints a line of coordinates each.

Usage: mds.py FILE. Called with the python of PERISCOPE_PYTHON.
"""

import sys

import numpy as np
from sklearn.manifold import MDS

for text in open(sys.argv[1]).read().strip().split("\n\n"):
    distances = np.array([[float(value) for value in line.split()] for line in text.splitlines()])
    mds = MDS(3, dissimilarity="precomputed", n_init=4, max_iter=3000, eps=1e-9, random_state=0, normalized_stress=False)
    print(*mds.fit_transform(distances).ravel())
