"""Files of several chains, stations and tools: blocks, their joints, and refusals."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.errors import InputError, RobotError
from calib_pin.io.measurements import read_configurations, read_measurements
from calib_pin.observations import BlockKey
from tests.shared import refused

ARMS = "torso,left,right,slide,chain,station,tool,x,y,z,target,set,payload\n"
"""Header of a file of both arms; the finger follows the right one."""

BOTH = f"""{ARMS}0.1,0.2,,,left_hand,day 1,probe,1,2,3,,train,
0.1,,0.4,0.3,,day 1,ball,1,2,3,,train,p
0.2,0.3,0.5,0.1,left_hand,day 2,probe,1,2,3,,validate,
,,,,world,day 1,,9,9,9,post,train,
0.2,,0.6,0.3,,day 1,ball,1,2,3,,train,
,0.5,0.6,0.3,touch,,ball,1,2,3,,train,
"""


def test_blocks_of_a_file(write, tree):
    data = read_measurements(write(BOTH), tree, notice=pytest.fail)
    assert data.keys == (
        BlockKey("position", "left_hand", "day 1", "probe"),
        BlockKey("position", "", "day 1", "ball"),
        BlockKey("position", "left_hand", "day 2", "probe"),
        BlockKey("position", "world", "day 1", ""),
        BlockKey("position", "touch", "", "ball"),
    )
    assert data.lines.tolist() == [2, 3, 6, 4, 5, 7]
    assert data.joints == ("torso", "left", "right", "finger", "slide")
    # What a chain does not need may be left out and is zero; the finger follows.
    q = "0.1 0.2 0 0.1 0 0.1 0 0.4 -0.1 0.3 0.2 0 0.6 -0.2 0.3 0.2 0.3 0.5 -0.15 0.1 "
    q += "0 0 0 0.1 0 0 0.5 0.6 -0.2 0.3"
    expected = np.array(q.split(), float).reshape(6, 5)
    np.testing.assert_allclose(data.q, expected, atol=1e-12)
    assert data.payload == ("", "p", "", "", "", "")
    assert data.target == ("", "", "", "", "post", "")
    assert data.validate.tolist() == [False, False, False, True, False, False]


def test_files_of_different_chains_have_the_joints_of_all(write, tree):
    left = write("torso,left,x,y,z,chain\n0.1,0.2,1,2,3,left_hand\n", "l.csv")
    plain = write("torso,right,slide,left,x,y,z\n0.1,0.2,0.3,0.4,1,2,3\n", "r.csv")
    start = "torso,left,distance,chain\n0.1,0.2,0,left_hand\n0.1,0.3,1,left_hand\n"
    starts = write(start, "s.csv")
    data = read_measurements([left, plain], tree)
    assert data.joints == ("torso", "left", "right", "finger", "slide")
    # The own file of the right hand has no need for the left one.
    np.testing.assert_allclose(
        data.q, [[0.1, 0.2, 0, 0.1, 0], [0.1, 0, 0.2, 0, 0.3]], atol=1e-12
    )
    alone = read_measurements(left, tree)
    assert (alone.joints, alone.keys[0].chain) == (("torso", "left"), "left_hand")
    # Measurements that are to be compared have the same joints.
    for names in (("left_hand", "touch"), ("", "left_hand")):
        assert read_measurements(left, tree.named(names)).joints == data.joints
    # A single chain is that of files that name none.
    chains = tree.named(("left_hand",))
    assert read_measurements(plain, chains).keys[0].chain == "left_hand"
    model = "relative-distance+position"
    data = read_measurements([starts, plain], tree, model=model)
    np.testing.assert_allclose(data.blocks[0].start, [[0.1, 0.2, 0, 0.1, 0]])


def test_what_stands_still_needs_no_joints(write, tree):
    # Nor does the reach of the robot say how far apart posts can stand.
    rows = "a,0,0,0,p,world\nb,40,0,0,p,world\na,40,0,0,q,world\n"
    data = read_measurements(write(f"station,x,y,z,target,chain\n{rows}"), tree)
    assert (data.q.shape, data.joints) == ((3, 0), ())
    assert [key.station for key in data.keys] == ["a", "b"]


def test_every_file_is_a_station(write, tree):
    text = "torso,left,x,y,z,chain\n0.1,0.2,1,2,3,left_hand\n"
    names = ("m.csv", "a/m.csv", "b/m.csv", "m-2.csv")
    files = [write(text, name) for name in names]
    data = read_measurements(files, tree, station_per_file=True)
    assert [key.station for key in data.keys] == ["m", "m-2", "m-3", "m-2-2"]
    assert data.files == tuple(map(str, files))
    file = write("torso,left,x,y,z,station\n0.1,0.2,1,2,3,a\n")
    with refused(InputError, file=str(file), column="station"):
        read_measurements(file, tree.named(("left_hand",)), station_per_file=True)


def test_sockets_of_a_station_are_those_of_all_tools_and_chains(write, tree):
    text = "torso,left,right,slide,chain,station,tool,target\n"
    text += "0,0,,,left_hand,a,t,s\n0,,0.5,0,,a,u,s\n"
    assert len(read_measurements(write(text), tree, model="fixed-point").blocks) == 2
    file = write(text.replace(",a,u", ",b,u"))
    with refused(InputError, line=2, reason="'s'"):
        read_measurements(file, tree, model="fixed-point")


def test_a_mimic_joint_follows_its_leader(write, tree):
    header = "torso,right,slide,finger [deg],distance\n"
    file = write(f"{header}0,0.2,0,0.05,1\n0,-0.2,0,{np.rad2deg(0.2):.3f},2\n")
    q = read_measurements(file, tree).q
    assert q[:, tree.joints.index("finger")].tolist() == [0.0, 0.2]
    assert read_configurations(file, tree).tobytes() == q.tobytes()
    file = write(f"{header}0,0.2,0,,1\n0,-0.2,0,10,2\n")
    with refused(InputError, ("'right'", "0.2 rad"), line=3, column="finger"):
        read_measurements(file, tree)


LEFT = "torso,left,x,y,z,chain"

# A file, line, column and value of the error, and what else tells it from others.
REFUSED = [
    (f"{ARMS}0,,,,left_hand,a,,1,2,3,,train,\n", 2, "left", ""),
    (f"{ARMS}0,,far,0,,a,,1,2,3,,train,\n", 2, "right", "far"),
    (f"{ARMS}0,0,0,9,,a,,1,2,3,,train,\n", 2, "slide", "9", "'slide [mm]'"),
    ("torso,right,slide,x,y,z,chain\n0,0,0,1,2,3,left_hand\n", 1, "left", None),
    (f"{LEFT}\n0,0,1,2,3,left_hnad\n", 2, "chain", "left_hnad", "'left_hand'"),
    (f"{ARMS},,,,world,a,,1,2,3,b@,train,\n", 2, "target", None),
    ("x,y,z,chain\n1,2,3,world\n", 2, "target", None, "'world'"),
    *(
        (f"{LEFT},{k}\n0,0,1,2,3,left_hand,a\n0,0,1,2,3,left_hand,\n", 3, k, None)
        for k in ("station", "tool")
    ),
]


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(write, tree, case):
    text, line, column, value, *words = case
    file = write(text)
    where = {"file": str(file), "line": line, "column": column, "value": value}
    with refused(InputError, words, **where):
        read_measurements(file, tree)


def test_a_chain_that_the_robot_leaves_open(write, tree):
    """Cells that are blank mean the default chain, which has to be one."""
    chains = type(tree)(tree.robot, names=("left_hand", "right_hand"))
    file = write("torso,left,x,y,z,chain\n0,0,1,2,3,left_hand\n0,0,1,2,3,\n")
    with refused(InputError, line=3, column="chain", value=""):
        read_measurements(file, chains)
    with pytest.raises(RobotError, match="right_hand"):
        read_measurements(write("torso,left,x,y,z\n0,0,1,2,3\n"), chains)
