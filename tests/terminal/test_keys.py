"""What terminals send for keys, recorded, and what the keys are called.

Keys were pressed and released by xdotool (X11; foot in weston) on a US keyboard: W held (most
repeats are left out here), Shift and A, released in either order, Ctrl+C, Escape, Tab, Enter,
Backspace, Shift+Tab, Up, Shift and / (Shift released first), keypad 5 and + with Num Lock on, F1.
Before them ``CSI > 31 u`` was sent.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsplat.terminal import Decoder, Event

KITTY = (  # 0.26.5 and 0.48.2; the former tells other modifiers with Shift and Ctrl themselves
    b"\x1b[119;;119u\x1b[119;1:2;119u\x1b[119;1:2;119u\x1b[119;1:3u"
    b"\x1b[57441;2u\x1b[97:65;2;65u\x1b[97:65;2:3u\x1b[57441;1:3u"
    b"\x1b[57441u\x1b[97:65;2;65u\x1b[57441;2:3u\x1b[97;1:3u"
    b"\x1b[57442;5u\x1b[99;5u\x1b[99;5:3u\x1b[57442;1:3u"
    b"\x1b[27u\x1b[27;1:3u\x1b[9u\x1b[9;1:3u\x1b[13u\x1b[13;1:3u\x1b[127u\x1b[127;1:3u"
    b"\x1b[57441;2u\x1b[9;2u\x1b[9;2:3u\x1b[57441;1:3u\x1b[A\x1b[1;1:3A"
    b"\x1b[57441;2u\x1b[47:63;2;63u\x1b[57441;1:3u\x1b[47;1:3u"
    b"\x1b[57360u\x1b[57404;129;53u\x1b[57360;129:3u\x1b[57404;129:3u"
    b"\x1b[57413;129;43u\x1b[57413;129:3u\x1b[1;129P\x1b[1;129:3P"
)
FOOT = (  # 1.28.0; 1.13.1 differs as kitty's do, and calls the keypad's + only 57413
    b"\x1b[119;1:1;119u\x1b[119;1:2;119u\x1b[119;1:2;119u\x1b[119;1:3u"
    b"\x1b[57441;2:1u\x1b[97:65;2:1;65u\x1b[97:65;2:3u\x1b[57441;1:3u"
    b"\x1b[57441;2:1u\x1b[97:65;2:1;65u\x1b[57441;1:3u\x1b[97;1:3u"
    b"\x1b[57442;5:1u\x1b[99;5:1u\x1b[99;5:3u\x1b[57442;1:3u"
    b"\x1b[27;1:1u\x1b[27;1:3u\x1b[9;1:1u\x1b[9;1:3u\x1b[13;1:1u\x1b[13;1:3u"
    b"\x1b[127;1:1u\x1b[127;1:3u\x1b[57441;2:1u\x1b[9;2:1u\x1b[9;2:3u\x1b[57441;1:3u"
    b"\x1b[1;1:1A\x1b[1;1:3A\x1b[57441;2:1u\x1b[47:63;2:1;63u\x1b[57441;1:3u\x1b[47;1:3u"
    b"\x1b[57360;129:1u\x1b[57404;129:1;53u\x1b[57360;129:3u\x1b[57404;129:3u"
    b"\x1b[43:57413;129:1;43u\x1b[43:57413;129:3u\x1b[1;129:1P\x1b[1;129:3P"
)
# 26.08.2: repeats as release and press, now and then as release and repeat; text with releases,
# too; keys of a US keyboard that are none (W: p); no key of its own for the keypad; and Shift and /
# is pressed as "?" and released as "/"
KONSOLE = (
    b"\x1b[119::112;1;119u\x1b[119::112;1:3;119u\x1b[119::112;1:2;119u"
    b"\x1b[119::112;1:3;119u\x1b[119::112;1;119u\x1b[119::112;1:3;119u"
    b"\x1b[57441;2u\x1b[97:65:108;2;65u\x1b[97:65:108;2:3;65u\x1b[57441;1:3u"
    b"\x1b[57441;2u\x1b[97:65:108;2;65u\x1b[57441;1:3u\x1b[97::108;1:3;97u"
    b"\x1b[57442;5u\x1b[99;5u\x1b[99;5:3u\x1b[57442;1:3u"
    b"\x1b[27u\x1b[27;1:3u\x1b[9;1;9u\x1b[9;1:3;9u\x1b[13;1;13u\x1b[13;1:3;13u"
    b"\x1b[127u\x1b[127;1:3u\x1b[57441;2u\x1b[9;2u\x1b[9;2:3u\x1b[57441;1:3u"
    b"\x1b[A\x1b[1;1:3A\x1b[57441;2u\x1b[63;2;63u\x1b[57441;1:3u\x1b[47;1:3;47u"
    b"\x1b[57360u\x1b[53;1;53u\x1b[57360;1:3u\x1b[53;1:3;53u"
    b"\x1b[43::60;1;43u\x1b[43::60;1:3;43u\x1bOP\x1b[1;1:3P"
)
XTERM = b"wAA\x03\x1b", b"\t\r\x7f\x1b[Z\x1b[A?5+\x1bOP"  # 379: no such protocol; Escape, a pause

PRESSED = [
    "w", "A", "A", "ctrl+c", "escape", "tab", "enter", "backspace", "shift+tab", "up", "?", "5",
    "+", "f1",
]  # fmt: skip
CODES = [
    "w", "a", "a", "c", "escape", "tab", "enter", "backspace", "tab", "up", "/", "keypad 5",
    "keypad +", "f1",
]  # fmt: skip


def decode(data, keyboard=True):
    decoder = Decoder()
    decoder.keyboard = keyboard
    return decoder.feed(data) + decoder.flush()


@pytest.mark.parametrize("data", [KITTY, FOOT, KONSOLE], ids=["kitty", "foot", "konsole"])
def test_keys_are_called_as_ever(data):
    """The names are those of a terminal without the protocol, however the keys are told."""
    names = [event.key for event in decode(data) if event.action == "press"]
    if data is KONSOLE:
        assert names.pop(1) == "w"  # a repeat told as a press
    assert names == PRESSED
    assert [event.key for piece in XTERM for event in decode(piece, False)] == PRESSED


@pytest.mark.parametrize(
    ("data", "codes"),
    [
        (KITTY, CODES),
        (FOOT, [*CODES[:12], "+", "f1"]),
        (KONSOLE, ["w", "w", *CODES[1:10], "?", "5", "+", "f1"]),
    ],
    ids=["kitty", "foot", "konsole"],
)
def test_a_release_has_the_code_of_its_press(data, codes):
    """Whether Shift is up before the letter or after it; Konsole's Shift and / is not so."""
    events = decode(data)
    assert [event.code for event in events if event.action == "press"] == codes
    down, unmatched = [], []
    for event in events:
        if event.action == "release":
            if event.code in down:
                down.remove(event.code)
            else:
                unmatched.append(event.code)
        elif event.action == "press":
            down.append(event.code)
        else:
            down += [event.code] if event.code not in down else []  # Konsole's
    assert (down, unmatched) == ((["?"], ["/"]) if data is KONSOLE else ([], []))


def test_repeats():
    """As often as they were told, with the name of the press."""
    repeats = [event for event in decode(KITTY) if event.action == "repeat"]
    assert repeats == [Event("key", "w", "repeat", code="w")] * 2


def test_without_releases_no_code():
    """Nothing is waited for that will not come; the same bytes where it will have one."""
    assert [event.code for event in decode(b"w\x1b[A\x1bOP\x1b[5~\x1b[Z", False)] == [""] * 5
    codes = [event.code for event in decode(b"w\x1b[A\x1bOP\x1b[5~\x1b[Z")]
    assert codes == ["", "up", "f1", "pageup", "tab"]


NAMES = {
    # Caps Lock (64) and Num Lock (128) are no modifiers, whatever they make
    b"\x1b[119;65;87u": ("W", "w"), b"\x1b[99;69u": ("ctrl+c", "c"), b"\x1b[1;193A": ("up", "up"),
    # no text: the letter with Shift, if it is told
    b"\x1b[97:65;2u": ("A", "a"), b"\x1b[47:63;2u": ("?", "/"), b"\x1b[97u": ("a", "a"),
    # control characters that are keys of their own, as without the protocol
    b"\x1b[122;5u": ("ctrl+z", "z"), b"\x1b[91;5u": ("escape", "["), b"\x1b[105;5u": ("tab", "i"),
    b"\x1b[109;5u": ("enter", "m"), b"\x1b[32;5u": ("ctrl+space", " "),
    b"\x1b[49;5u": ("ctrl+1", "1"), b"\x1b[99;6u": ("ctrl+c", "c"),
    b"\x1b[13;2u": ("enter", "enter"), b"\x1b[127;5u": ("backspace", "backspace"),
    # C on a Cyrillic keyboard, which is the key of a US one that counts with Ctrl
    b"\x1b[1089::99;5u": ("ctrl+c", "с"), b"\x1b[1089::99;;1089u": ("c", "с"),  # noqa: RUF001
    # W and Shift and W there; what is [ on a US one; a key whose place is not told
    b"\x1b[1094::119;;1094u": ("w", "ц"), b"\x1b[1094:1062:119;2;1062u": ("W", "ц"),
    b"\x1b[1094::119;1:2;1094u": ("w", "ц"), b"\x1b[1094::119;1:3u": ("w", "ц"),
    b"\x1b[1093::91;;1093u": ("[", "х"), b"\x1b[1094;;1094u": ("ц", "ц"),  # noqa: RUF001
    # Latin letters are what they are, wherever they are: Z on a German keyboard, A on a French one
    b"\x1b[122::121;;122u": ("z", "z"), b"\x1b[97::113;;97u": ("a", "a"),
    b"\x1b[246::59;;246u": ("ö", "ö"),
    # Alt; Option that composes; Super is none of the others
    b"\x1b[120;3;120u": ("alt+x", "x"), b"\x1b[97:65;4;65u": ("alt+A", "a"),
    b"\x1b[99;7u": ("alt+ctrl+c", "c"), b"\x1b[97;3;229u": ("å", "a"), b"\x1b[97;;229u": ("å", "a"),
    b"\x1b[113;9u": ("super+q", "q"), b"\x1b[13;3u": ("alt+enter", "enter"),
    # the keypad
    b"\x1b[57414u": ("enter", "keypad enter"), b"\x1b[57419;5u": ("ctrl+up", "keypad up"),
    b"\x1b[57412;;45u": ("-", "keypad -"), b"\x1b[57399u": ("0", "keypad 0"),
    b"\x1b[57426u": ("delete", "keypad delete"),
    # text of no key
    b"\x1b[0;;228u": ("ä", ""), b"\x1b[;;228u": ("ä", ""),
    b"\x1b[13~": ("f3", "f3"),
}  # fmt: skip


@pytest.mark.parametrize("data", NAMES)
def test_names(data):
    """By kitty's specification."""
    name, code = NAMES[data]
    action = "repeat" if b";1:2" in data else "release" if b";1:3" in data else "press"
    assert decode(data) == [Event("key", name, action, code=code)]


def test_places_that_are_wrong_are_not_believed():
    """As Konsole's are: a letter is itself then, but for Ctrl."""
    decoder = Decoder()
    decoder.places = False
    (event,) = decoder.feed(b"\x1b[1094::112;;1094u")
    assert (event.key, event.code) == ("ц", "ц")
    (event,) = decoder.feed(b"\x1b[1089::99;5u")
    assert event.key == "ctrl+c"


@pytest.mark.parametrize(
    "data",
    [
        b"\x1b[57358u", b"\x1b[57441;2u", b"\x1b[57454u", b"\x1b[57428;1:3u", b"\x1b[57376u",
        b"\x1b[u", b"\x1b[0u", b"\x1b[0;;u", b"\x1b[97;1:4u", b"\x1b[97;1:9;97u", b"\x1b[8;1:1u",
        b"\x1b[55296u", b"\x1b[1114112u", b"\x1b[99999999u", b"\x1b[;u", b"\x1b[::;:u",
        b"\x1b[133u", b"\x1b[0;1:3;228u", b"\x1b[E", b"\x1b[57427~", b"\x1b[?0u", b"\x1b[?31u",
        b"\x1b_Gi=31;OK\x1b\\", b"\x1b_Gi=7,p=1;ENOENT:no such picture\x1b\\",
    ],
)  # fmt: skip
@pytest.mark.parametrize("keyboard", [False, True])
def test_no_key(data, keyboard):
    """Modifiers, media keys, numbers that are no character, answers, unknown kinds of events."""
    assert decode(data + b"\x1b[113;;113u", keyboard) == [Event("key", "q", code="q")]


@given(st.lists(st.integers(0, 1 << 21) | st.none(), max_size=5), st.text(";:", max_size=5),
       st.sampled_from("uABCPR~Z"), st.booleans())  # fmt: skip
def test_whatever_the_numbers_are(numbers, marks, final, keyboard):
    """At most one key comes of them, with a name fit to print; never their digits."""
    parts = ["" if number is None else str(number) for number in numbers]
    body = "".join(part + mark for part, mark in zip(parts, marks + ";" * 5, strict=False))
    events = decode(f"\x1b[{body}{final}".encode(), keyboard)
    assert len(events) <= 1
    for event in events:
        assert event.kind == "key"
        assert event.key.isprintable()
        assert event.action in ("press", "repeat", "release")


# Drags by 10 and 10 px, recorded with 1002, 1006 and 1016 on; cells of 10x19 px, foot 10x20
DRAGS = {
    "kitty": (b"\x1b[<0;100;100M\x1b[<32;103;101M\x1b[<32;107;105M\x1b[<0;107;105m", 19),
    "konsole": (b"\x1b[<0;100;100M\x1b[<32;103;101M\x1b[<32;107;105M\x1b[<3;107;105m", 19),
    "foot": (b"\x1b[<0;101;101M\x1b[<32;104;102M\x1b[<32;108;106M\x1b[<0;108;106m", 20),
    "xterm": (b"\x1b[<0;101;101M\x1b[<32;104;102M\x1b[<32;108;106M\x1b[<0;108;106m", 19),
}


@pytest.mark.parametrize("name", DRAGS)
def test_drags_in_pixels(name):
    """Steps of a part of a cell; the release is one, though Konsole's is of no button."""
    data, height = DRAGS[name]
    decoder = Decoder()
    decoder.cell = 10.0, float(height)
    events = decoder.feed(data)
    assert [event.action for event in events] == ["press", "drag", "drag", "release"]
    assert [event.button for event in events[:3]] == ["left"] * 3
    xs = [event.x - events[0].x for event in events]
    assert xs == pytest.approx([0, 0.3, 0.7, 0.7])
    assert events[3].y - events[0].y == pytest.approx(5 / height)
    assert 9.8 < events[0].x < 10.1


def test_a_mouse_outside_of_the_window():
    """Less than nothing is nothing, and no digit of it a key."""
    decoder = Decoder()
    assert decoder.feed(b"\x1b[<32;-") == []
    assert decoder.feed(b"12;-3Mq") == [
        Event("mouse", action="drag", button="left"), Event("key", "q"),
    ]  # fmt: skip
    release = Event("mouse", action="release")
    assert decoder.feed(b"\x1b[<3;1;1M") == [release]  # of no button: a press there is none


def test_focus_and_sizes():
    """Focus gained and lost; rows, columns and then px, width first, as TIOCGWINSZ has them."""
    assert decode(b"\x1b[I\x1b[O") == [
        Event("focus", action="in"), Event("focus", action="out"),
    ]  # fmt: skip
    assert decode(b"\x1b[48;24;80;456;800t") == [Event("resize", size=(24, 80, 800, 456))]
    decoder = Decoder()
    assert decoder.feed(b"\x1b[6;19;10t\x1b[4;456;800t\x1b[8;24;80t\x1b[48;1;2t") == []
