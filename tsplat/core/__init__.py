"""What a picture is: types, stage contracts, constants and the NumPy reference."""
