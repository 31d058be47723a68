"""What a third party needs to prove a backend or presenter; tsplat's own tests use the same.

``checks`` compares a backend with the reference on a given scene, ``stiff`` with ``oracle`` on the
hardest ones; they need nothing but NumPy.
``strategies`` and ``conformance`` need hypothesis (``pip install tsplat[test]``).
"""
