"""Encoding and playing: what arrives, what is refused, what can be interrupted."""

import copy
import pathlib
import pickle
import threading
from typing import Any

import numpy as np
import pytest

import dgs


@pytest.fixture(scope="module")
def scene() -> dgs.Scene:
    """A scene that moves."""
    return dgs.Scene.synth("figure", gaussians=1000, frames=4)


@pytest.fixture(scope="module")
def encoded(scene: dgs.Scene) -> dgs.Encoded:
    """The scene, encoded."""
    return dgs.encode(scene, pictures=0)


def test_the_report_says_where_bytes_went(encoded: dgs.Encoded) -> None:
    report = encoded.report
    assert report["wire_bytes"] == encoded.stream.wire_bytes
    assert report["report"]["ledger"] and report["bits_per_gaussian"] > 0
    assert encoded.stream.info["frames"] == 4 and encoded.stream.info["gaussians"] == 1000
    assert bytes(encoded) == encoded.to_bytes() == bytes(encoded.stream)


def test_the_same_options_give_the_same_bytes(scene: dgs.Scene, encoded: dgs.Encoded) -> None:
    assert bytes(dgs.encode(scene, pictures=0)) == bytes(encoded)
    assert bytes(dgs.encode(scene, pictures=0, coarseness=2.0)) != bytes(encoded)


def test_a_target_is_met(scene: dgs.Scene) -> None:
    assert dgs.encode(scene, pictures=0, target_bytes=15_000).stream.wire_bytes <= 15_000
    with pytest.raises(ValueError, match="target_bytes and target_psnr"):
        dgs.encode(scene, target_bytes=1000, target_psnr=30)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"profile": "other"}, "profile"),
        ({"coarseness": float("nan")}, "coarseness"),
        ({"block_len": 0}, "block_len"),
        ({"block_len": -1}, "block_len is -1"),
        ({"repair": "base=1+"}, "repair"),
        ({"target_psnr": 1e9}, "target_psnr"),
    ],
)
def test_options_out_of_range_are_named(scene: dgs.Scene, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        dgs.encode(scene, **options)


def test_packets_arrive_in_any_order(encoded: dgs.Encoded) -> None:
    stream = encoded.stream
    whole = dgs.Player(stream)
    player = dgs.Player.from_manifest(stream.manifest)
    assert 0 < player.drawn(0).sum() < 100, "stand-ins"
    for packet in reversed(stream.packets):
        assert len(player.push(packet)) == 1
    assert player.push(stream.packets[0]) == []
    assert player.counters["refused"]["duplicate"] == 1
    for frame in range(4):
        for a, b in zip(player.frame(frame), whole.frame(frame), strict=True):
            assert np.array_equal(a, b)
    assert whole.drawn(0).all() and whole.info == player.info
    usable = whole.usable(0)
    assert usable["canonical"] == [usable["blocks"]] * 4


def test_bytes_of_any_kind_are_taken(encoded: dgs.Encoded) -> None:
    stream, data = encoded.stream, bytes(encoded)
    for kind in (bytes, bytearray, memoryview):
        assert bytes(dgs.Stream(kind(data))) == data and dgs.Player(kind(data)).info["frames"] == 4
        player = dgs.Player.from_manifest(kind(stream.manifest))
        assert player.push(kind(stream.packets[0])) == [0]
        player.push_all([kind(packet) for packet in stream.packets])
        assert player.counters["media"] == len(stream)
        assert player.counters["early"] == player.counters["repair_failed"] == 0
    with pytest.raises(TypeError, match="packet is a .*str"):
        player.push("packet")  # type: ignore[arg-type]


def test_streams_are_copied_and_pickled(encoded: dgs.Encoded) -> None:
    cut_off = dgs.Stream(bytes(encoded)[:-40])
    for stream in (encoded.stream, encoded.stream.without([1, 3]), cut_off):
        for same in (copy.copy(stream), copy.deepcopy(stream), pickle.loads(pickle.dumps(stream))):
            assert (same.manifest, same.packets, same.damage) == (stream.manifest, stream.packets, stream.damage)
    assert cut_off.damage is not None


def test_what_is_lost_does_not_arrive(encoded: dgs.Encoded) -> None:
    stream = encoded.stream
    some = stream.without(range(0, len(stream), 2))
    arrived = dgs.Player(some)
    assert arrived.damage is None and arrived.counters["media"] == len(stream) // 2
    frame = arrived.frame(1, activation="linear")
    assert np.array_equal(frame.opacities > 0, arrived.drawn(1))
    assert np.isfinite(np.concatenate([array.ravel() for array in arrived.frame(1)])).all()
    # Packets that a file never held are no damage; an end that is missing is.
    assert dgs.Player(some.to_bytes()).damage is None
    cut_off = dgs.Player(some.to_bytes()[:-40])
    assert cut_off.damage is not None and "cut off" in cut_off.damage
    for wrong in (len(stream), -1):
        with pytest.raises(ValueError, match=f"packets.* {wrong}"):
            stream.without([wrong])


def test_parity_repairs(scene: dgs.Scene) -> None:
    stream = dgs.encode(scene, pictures=0, repair="base=4+1").stream
    player = dgs.Player(stream.without([0]))
    assert player.counters["recovered"] == 1


def test_bytes_that_lie_are_refused(encoded: dgs.Encoded, tmp_path: pathlib.Path) -> None:
    assert issubclass(dgs.DamagedError, ValueError)
    for junk in (b"", b"DGS?", bytes(100)):
        with pytest.raises(dgs.DamagedError):
            dgs.Player(junk)
    with pytest.raises(dgs.DamagedError):
        dgs.Player.from_manifest(b"nothing")
    player = dgs.Player(encoded.stream)
    packet = bytearray(encoded.stream.packets[0])
    packet[-1] ^= 1
    with pytest.raises(dgs.DamagedError):
        player.push(bytes(packet))
    with pytest.raises(IndexError, match="frame is 4; 0 to 3"):
        player.frame(4)
    with pytest.raises(FileNotFoundError):
        dgs.Stream(tmp_path / "none.dgs")
    with pytest.raises(TypeError, match="bytes, a path or a Stream"):
        dgs.Player(3)  # type: ignore[arg-type]


def test_files_hold_streams(encoded: dgs.Encoded, tmp_path: pathlib.Path) -> None:
    encoded.save(tmp_path / "a.dgs")
    assert bytes(dgs.Stream(tmp_path / "a.dgs")) == bytes(encoded)
    assert dgs.Player(str(tmp_path / "a.dgs")).info["frames"] == 4


def test_progress_is_heard_and_may_stop_the_work(scene: dgs.Scene) -> None:
    heard: list[tuple[str, float]] = []
    dgs.encode(scene, pictures=0, progress=lambda stage, share: heard.append((stage, share)))
    assert [stage for stage, _ in heard][0] == "analyse" and all(0 <= share <= 1 for _, share in heard)

    def stop(stage: str, share: float) -> None:
        if stage == "packetise":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dgs.encode(scene, pictures=0, progress=stop)


def test_ctrl_c_ends_an_encoding(scene: dgs.Scene) -> None:
    import _thread
    import signal

    def interrupt(stage: str, share: float) -> None:
        if stage == "decide":
            _thread.interrupt_main()

    # What runs in the background of a shell begins with the signal ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            dgs.encode(scene, pictures=0, progress=interrupt)
    finally:
        signal.signal(signal.SIGINT, before)


def test_several_threads_play_one_stream(encoded: dgs.Encoded) -> None:
    player = dgs.Player(encoded.stream)
    expected = [player.frame(frame).means for frame in range(4)]
    found: list[bool] = []

    def play() -> None:
        for frame in (3, 1, 0, 2) * 5:
            found.append(np.array_equal(player.frame(frame).means, expected[frame]))

    threads = [threading.Thread(target=play) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 80 and all(found)
