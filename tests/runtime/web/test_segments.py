"""Segments in a page: what is opened when, what is closed, and which failures are tried again."""

import json
import subprocess
from typing import Any

from support.web.packages import package
from support.web.pages import CLIENT

_START = """
const [segments, once] = await Promise.all(process.argv.slice(1).map((module) => import(module)));
const log = [];
const failing = new Set();
const openModel = async (name, signal) => {
  log.push(`open ${name}`);
  await null;
  signal?.throwIfAborted();
  if (failing.has(name)) throw new Error(`no ${name}`);
  const update = async () => false;
  const followsCamera = name === "b";
  return { sets: [], buffers: {}, extent: {}, up: [], time: null, followsCamera, update, destroy: () => log.push(`close ${name}`) };
};
const settled = () => new Promise((resolve) => setTimeout(resolve, 5));
const taken = () => log.splice(0);
const names = ["a", "b", "c"];
const parts = names.map((path) => ({ path, seconds: 1 }));
const open = () => segments.SegmentedModel.open({ segments: parts, capacity: 9 }, ({ path }, signal) => openModel(path, signal));
const show = async (model, time) => {
  const error = await model.update({ time }).then(() => null, ({ message }) => message);
  await settled();
  return [error, taken()];
};
"""


def answer(script: str) -> Any:
    """Run a script after that above, and return what it tells."""
    package("types-0.1.74", needs_node=True)  # Node.js is there where other packages are
    modules = [(CLIENT / name).as_uri() for name in ("segments.js", "once.js")]
    command = ["node", "--input-type=module", "--eval", _START + script, *modules]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.stderr == ""
    return json.loads(result.stdout)


def test_two_segments_are_open_and_a_lost_one_is_asked_for_again_at_its_time() -> None:
    told = answer("""
const told = [];
const model = await open();
for (const time of [0, 0.5, 1, 2, 3]) told.push(await show(model, time));
told.push(await show(model, 0));
failing.add("b");
model._opened.delete(1);
for (const time of [0, 0.1, 0.2, 1]) told.push(await show(model, time));
failing.clear();
told.push(await show(model, 1.1));
console.log(JSON.stringify(told));
""")
    assert told == [
        [None, ["open a", "open b"]],
        [None, []],
        [None, ["open c", "close a"]],  # at the end of a segment, the next one is shown
        [None, ["open a", "close b"]],
        [None, []],  # the last one at the end of all
        [None, ["open b", "close c"]],
        [None, ["open b"]],  # in vain
        [None, []],
        [None, []],
        ["no b", ["open b"]],
        [None, ["open b", "open c", "close a"]],
    ]


def test_frames_follow_the_camera_while_a_segment_does() -> None:
    told = answer("""
const model = await open();
const told = [];
for (const time of [0, 1, 2]) {
  await show(model, time);
  told.push(model.followsCamera);
}
console.log(JSON.stringify(told));
""")
    assert told == [False, True, False]


def test_a_model_that_goes_in_the_midst_of_a_frame_leaves_nothing_open() -> None:
    told = answer("""
const told = [];
for (const time of [0, 1, 2]) {
  const model = await open();
  const frame = model.update({ time }).catch(() => {});
  model.destroy();
  await frame;
  await settled();
  told.push([taken().filter((line) => line.startsWith("close")), [...model._opened.keys()]]);
}
console.log(JSON.stringify(told));
""")
    assert told == [[["close a"], []]] * 3


def test_of_remembered_values_those_asked_for_last_stay() -> None:
    told = answer("""
const made = [];
const map = new Map();
const ask = (key) => once.remembered(map, key, () => made.push(key), 2);
for (const key of ["a", "b", "a", "a", "c", "a", "b"]) ask(key);
console.log(JSON.stringify([made, [...map.keys()]]));
""")
    assert told == [["a", "b", "c", "b"], ["a", "b"]]
