"""What a third party needs to prove a backend or presenter; tsplat's own tests use the same.

``checks`` compares a backend with the reference on a given scene, ``tiles`` a part of one picture,
``stiff`` with ``oracle`` the hardest scenes; they need nothing but NumPy.
``strategies``, ``conformance`` and ``laws`` need hypothesis (``pip install tsplat[test]``).
"""
