"""Expressions of xacro files: what they mean, and that nothing leads out of them."""

from __future__ import annotations

import math
from typing import Any

import pytest
import xacro

from calib_pin.io import xacro_expressions
from calib_pin.io.xacro_expressions import Refused, evaluate

SYMBOLS: dict[str, Any] = {
    "x": 3,
    "_y": 4,
    "name": "left_arm",
    "xyz": [0.1, 0.2, 0.3],
    "limits": xacro.YamlDictWrapper(
        {"elbow": {"lower": -1.5, "list": [1, 2]}, "items": 5}
    ),
    "list_of_links": ["a", "b"],
}

MEANT = """
1 + 2 * 3 - 4 / 5
7 // 2 + 7 % 4
2 ** 10 - x ** -1
x == 3 and name != 'right_arm'
1 < x <= 3
3 < x < 9
x > 5 or x < 4
'left' in name
'a' not in xyz
name if x > 2 else 'no'
name[:4] + '_' + str(x)
limits['elbow']['lower']
limits.elbow.lower * 2
math.radians(90) + math.pi
sin(0.3) ** 2 + cos(0.3) ** 2
atan2(1, 2)
math.sqrt(2) * math.fabs(-1)
max(1, x, 2) + min([4, 5])
round(2.567, 2)
int('12') + float('1.5')
len(xyz)
dict(a=1, b=2)['b']
name.split('_')[0]
name.replace('left', 'right').upper()
' '.join([str(value) for value in xyz])
[value for value in list(range(5)) if value % 2]
list(map(float, '1 2'.split()))
sorted(['b', 'a'])
'%03d_%s' % (x, name)
[0] * 3
(1, 2)[1]
True and not False
1./12 * (3 * x**2 + _y**2)
'elbow' in limits and 'list' in limits.elbow
'0 1 2'.split(' ')[1]
"""


def test_it_means_what_xacro_makes_of_it() -> None:
    table = xacro.Table(xacro.create_global_symbols())
    for name, value in SYMBOLS.items():
        table._setitem(name, value, unevaluated=False)
    for text in filter(None, MEANT.splitlines()):
        expected = eval(text, {**vars(math), "math": math}, _Python(table))
        assert evaluate(text, table, {}) == expected, text


class _Python(dict[str, Any]):
    """The symbols, with the namespace that xacro has for Python's functions."""

    def __init__(self, table: Any) -> None:
        self.table = table

    def __getitem__(self, name: str) -> Any:
        return self.table[name]


HOSTILE = """
(y for y in [1]).gi_frame.f_back.f_builtins['__imp' + 'ort__']('os')
[].__class__.__base__.__subclasses__()
().__class__
__import__('os').system('true')
compile('1', '', 'eval')
getattr(name, '__class__')
type(name)
globals()
'{0.__class__}'.format(name)
'%(a)s' % dict(a=1)
'%999999999d' % 1
'%*d' % (999999999, 1)
(lambda: 1)()
[y := 1]
f'{name}'
xacro.load_yaml.__globals__
xacro.load_yaml
math.sin.__self__
math
sin
[print for y in [1]]
list(map(print, xyz))
sorted(xyz, key=print)
limits.items.__self__
limits.pop('elbow')
xyz.append(1)
xyz[0:2].__init__
9 ** 9 ** 9
2 ** 100000
'a' * 10 ** 9
[0] * 10 ** 9
list(range(10 ** 9))
[y for y in range(9999) if [z for z in range(9999) if True]]
1j
name.replace('', 'a' * 9999)
('a' * 9999).join(list(range(999)))
(-8) ** 0.5
await x
x = 1
*xyz
dict(**limits)
max(*xyz)
[y for y in xyz for z in xyz]
1 << 10 ** 9
unknown
limits.unknown
xyz[7]
1 / 0
math.sqrt(-1)
exp(1000)
__hidden
limits.__missing
"""


ENDLESS = ("-" * 9000 + "1", "(" * 4000 + ")" * 4000, "x" * 10_001)


@pytest.mark.parametrize("text", [*filter(None, HOSTILE.splitlines()), *ENDLESS])
def test_what_is_refused(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xacro_expressions, "STEPS", 20_000)
    with pytest.raises(Refused):
        evaluate(text, {**SYMBOLS, "__hidden": 1}, {"xacro.load_yaml": open})
    assert SYMBOLS["xyz"] == [0.1, 0.2, 0.3]
