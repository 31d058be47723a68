"""A plain terminal of cells: what a stream of bytes shows, and where it wrote."""

from __future__ import annotations

from tsplat.testing.stream import columns_of, numbers, tokens


class Grid:
    """``text(row)`` is what is seen there; ``marked(row)`` whether any of it is in reverse.

    It knows what the viewer and half blocks send; anything else is an error, so that nothing is
    passed over in silence.
    """

    def __init__(self, columns, rows):
        self.columns, self.rows = columns, rows
        self.x = self.y = 0
        self.reverse = False
        self.cells = [[" "] * columns for _ in range(rows)]
        self.reversed = [[False] * columns for _ in range(rows)]
        self.painted = False
        self.written = set()  # (x, y) of what has a colour: a picture's

    def feed(self, data):
        """Takes a stream that begins and ends between two sequences."""
        for token in tokens(data):
            getattr(self, f"_{token.kind}")(token.body)
        return self

    def text(self, row):
        return "".join(self.cells[row])

    def marked(self, row):
        return any(self.reversed[row])

    def _text(self, body):
        for character in body.decode():
            for cell in [character, *[""] * (columns_of(character) - 1)]:
                assert self.x < self.columns, "written past the last column"
                self.cells[self.y][self.x] = cell
                self.reversed[self.y][self.x] = self.reverse
                if self.painted:
                    self.written.add((self.x, self.y))
                self.x += 1

    def _control(self, body):
        if body == b"\r":
            self.x = 0
        elif body == b"\n":
            self.y += 1
            assert self.y < self.rows, "scrolled"
        else:
            raise AssertionError(body)

    def _string(self, body):
        assert body[:1] == b"_" or body[:2] in (b"]1", b"P+", b"P$", b"P0"), body[:20]

    def _escape(self, body):
        pass

    def _csi(self, body):
        final = chr(body[-1])
        if body[:1] in b"?>=<" or b"$" in body or b" " in body or final in "cntuqhlsx":
            return  # modes and questions
        values = numbers(body[:-1])
        n = max(1, values[0] if values else 1)
        if final == "H":
            row, column = [*values, 1, 1][:2]
            self.y, self.x = max(row, 1) - 1, max(column, 1) - 1
            assert self.y < self.rows
            assert self.x < self.columns
        elif final == "m":
            self._sgr(values or [0])
        elif final == "K":
            assert not values
            self._blank(self.y, self.x)
        elif final == "J":
            assert values == [2]
            for row in range(self.rows):
                self._blank(row, 0)
        elif final in "CD":
            self.x += n if final == "C" else -n
        elif final == "b":
            self._text(self.cells[self.y][self.x - 1].encode() * n)
        else:
            raise AssertionError(body)

    def _blank(self, row, column):
        self.cells[row][column:] = [" "] * (self.columns - column)
        self.reversed[row][column:] = [False] * (self.columns - column)

    def _sgr(self, values):
        rest = list(values)
        while rest:
            n = rest.pop(0)
            if n in (0, 38, 48):
                self.painted = n > 0
            if n in (38, 48):
                del rest[: {2: 4, 5: 2}[rest[0]]]
            elif n in (0, 27):
                self.reverse = False
            elif n == 7:
                self.reverse = True
