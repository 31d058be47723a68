"""What a third party needs to prove a backend or presenter; tsplat's own tests use the same.

``checks`` compares a backend with the reference on a given scene, ``tiles`` a part of one picture;
both need nothing but NumPy.
``strategies``, ``conformance`` and ``laws`` need hypothesis (``pip install tsplat[test]``).
"""
