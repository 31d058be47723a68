"""What a third party needs to prove a backend or presenter; tsplat's own tests use the same.

``checks`` compares a backend with the reference on a given scene, ``tiles`` a part of one picture,
``stiff`` with ``oracle`` on the hardest scenes; ``decoders`` reads what presenters write,
``stream`` what their bytes do to a screen. They need nothing but NumPy (and Pillow for pictures).
``strategies``, ``conformance``, ``laws``, ``presenting`` and ``kit``, which has all of them, need
hypothesis (``pip install tsplat[test]``).
"""
