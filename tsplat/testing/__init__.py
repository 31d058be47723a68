"""What a third party needs to prove a backend or presenter; tsplat's own tests use the same.

``checks`` compares a backend with the reference on a given scene, ``stiff`` with ``oracle`` on the
hardest ones, ``decoders`` reads what presenters write, ``stream`` what their bytes do to a screen;
they need nothing but NumPy (and Pillow for JPEG and PNG).
``strategies``, ``conformance``, ``laws``, ``presenting`` and ``kit``, which has all of them, need
hypothesis (``pip install tsplat[test]``).
"""
