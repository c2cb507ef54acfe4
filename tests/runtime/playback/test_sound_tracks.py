"""Sound of WAV files as a model hears it: the newest samples before each frame."""

import json
import wave
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.conformance.fixtures.valid.avatars import sound_model
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.manifest import Input
from gsgen.formats import write_ply
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.runtime.media.mp4 import encode
from gsgen.runtime.playback.sound_tracks import film_sound, read_sound, sound_track
from gsgen.runtime.sources.key_frames import SceneSound
from support.commands import gsgen_here

RATE = 1000
SOUND = Input(name="sound", role="audio", shape=(64,), convention="samples", rate=RATE)


def write_wav(path: Path, data: bytes, *, rate: int = RATE, width: int = 2, channels: int = 1):
    with wave.open(str(path), "wb") as file:
        file.setnchannels(channels)
        file.setsampwidth(width)
        file.setframerate(rate)
        file.writeframes(data)
    return path


def noise(count: int) -> np.ndarray:
    return np.random.default_rng(0).integers(-(2**15), 2**15, count).astype("<i2")


@pytest.mark.parametrize(("fps", "count"), [(25.0, 500), (30.0, 501), (24.0, 3), (250.0, 70)])
def test_the_last_sample_of_a_frame_is_that_of_its_moment(
    tmp_path: Path, fps: float, count: int
) -> None:
    samples = noise(count)
    track = sound_track(write_wav(tmp_path / "a.wav", samples.tobytes()), SOUND, (64,), fps)
    frames = track.frames((64,))
    assert frames == max(1, -(-count * fps // RATE))
    for number in range(frames):
        last = min(round(number / fps * RATE), count - 1)
        expected = [samples[i] / 2**15 if i >= 0 else 0.0 for i in range(last - 63, last + 1)]
        np.testing.assert_array_equal(track.value_at((64,), number, frames), np.float32(expected))


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_samples_of_all_widths_and_channels_are_read(tmp_path: Path, width: int) -> None:
    numbers = np.random.default_rng(1).integers(-128, 128, (50, 2))
    scaled = numbers * 2 ** (8 * width - 8) + (128 if width == 1 else 0)
    data = b"".join(int(n).to_bytes(width, "little", signed=width > 1) for n in scaled.flat)
    amplitudes, rate = read_sound(
        write_wav(tmp_path / "a.wav", data, width=width, channels=2, rate=8000)
    )
    assert rate == 8000
    np.testing.assert_allclose(amplitudes, numbers.mean(axis=1) / 128, atol=1e-7)


def test_a_tone_of_another_rate_is_resampled(tmp_path: Path) -> None:
    tone = np.sin(2 * np.pi * 20 * np.arange(3000) / 3000)
    data = np.rint(30_000 * tone).astype("<i2").tobytes()
    track = sound_track(write_wav(tmp_path / "a.wav", data, rate=3000), SOUND, (64,), fps=10.0)
    heard_tone = 30_000 / 2**15 * np.sin(2 * np.pi * 20 * np.arange(500 - 63, 501) / RATE)
    np.testing.assert_allclose(track.value_at((64,), 5, 10), heard_tone, atol=2e-3)


@pytest.mark.parametrize(
    ("spec", "shape", "message"),
    [
        (Input(name="a", role="audio", convention="mel", rate=RATE), (8, 10), "takes mel energies"),
        (Input(name="a", role="control", range=(0, 1)), (64,), "takes the role control"),
        (SOUND, ((1 << 28) + 1,), "take more than 1 GiB"),
    ],
)
def test_inputs_that_take_no_samples_are_refused(
    tmp_path: Path, spec: Input, shape: tuple[int, ...], message: str
) -> None:
    path = write_wav(tmp_path / "a.wav", noise(10).tobytes())
    with pytest.raises(ConfigInvalid, match=message):
        sound_track(path, spec, shape, 25.0)


@pytest.mark.parametrize("data", [b"", b"RIFF", b"RIFF\0\0\0\0WAVE", b"\x89PNG\r\n\x1a\n" * 9])
def test_files_without_sound_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.wav"
    path.write_bytes(data)
    with pytest.raises(ConfigInvalid, match=r"a\.wav: is no WAV of PCM"):
        read_sound(path)
    with pytest.raises(ConfigInvalid, match="cannot be read"):
        read_sound(tmp_path / "absent.wav")
    with pytest.raises(ConfigInvalid, match="no samples"):
        read_sound(write_wav(path, b""))


def test_a_film_is_as_long_as_its_sound(tmp_path: Path) -> None:
    sound_model().write(tmp_path / "mouth.onnx")
    write_wav(tmp_path / "speech.wav", noise(4000).tobytes(), rate=16000)
    words = ("render", "mouth.onnx", "-o", "talk", "--width", "24", "--height", "16", "--fps", "20")
    completed = gsgen_here(*words, "--input", "audio=speech.wav", cwd=tmp_path)
    assert completed.code == 0, completed.err
    assert len(list((tmp_path / "talk").iterdir())) == 5  # a quarter of a second
    completed = gsgen_here(*words, "--input", "speech=speech.wav", cwd=tmp_path)
    assert completed.code == 2
    assert "names the input 'speech', which no scene has" in completed.err


@pytest.mark.parametrize("start", [0.0, 0.25, -0.125, -2.0, 5.0, 0.9])
def test_a_recording_keeps_its_place_on_the_timeline(tmp_path: Path, start: float) -> None:
    samples = noise(400)
    path = write_wav(tmp_path / "a.wav", samples.tobytes())
    sound = film_sound(SceneSound(path=path, start=start), 1.0)
    assert (sound.rate, len(sound.samples)) == (RATE, RATE)
    for number, sample in enumerate(sound.samples):
        place = number - round(start * RATE)
        assert sample == (samples[place] / 2**15 if 0 <= place < 400 else 0)


@pytest.mark.parametrize("rate", [44_100, 88_200, 192_000])
def test_a_film_takes_recordings_of_all_rates(tmp_path: Path, rate: int) -> None:
    tone = np.sin(2 * np.pi * 400 * np.arange(rate // 10) / rate)
    data = np.rint(30_000 * tone).astype("<i2").tobytes()
    sound = film_sound(SceneSound(path=write_wav(tmp_path / "a.wav", data, rate=rate)), 0.1)
    assert sound.rate == min(rate, 48_000)
    expected = np.sin(2 * np.pi * 400 * np.arange(len(sound.samples)) / sound.rate)
    inner = slice(200, -200)  # the filter knows no samples beyond the ends
    np.testing.assert_allclose(sound.samples[inner], expected[inner] * 30_000 / 2**15, atol=0.01)
    assert b"ipcm" in encode([Image.new("RGB", (16, 16))], 10, sound)


@pytest.mark.parametrize(("place", "value"), [(24, 4_000_000_000), (34, 40), (34, 64)])
def test_recordings_of_other_widths_or_absurd_rates_are_refused(
    tmp_path: Path, place: int, value: int
) -> None:
    path = write_wav(tmp_path / "a.wav", noise(40).tobytes())
    header = bytearray(path.read_bytes())
    size = 4 if place == 24 else 2
    header[place : place + size] = value.to_bytes(size, "little")
    path.write_bytes(header)
    with pytest.raises(ConfigInvalid, match=f"has .*{value:,}.*, expected 8, 16, 24 or 32 bits"):
        read_sound(path)


def test_a_film_of_segments_is_heard_from_its_start(tmp_path: Path) -> None:
    """However the clip is cut, a sample is heard at its second; a film of another length is silent."""
    write_ply(tmp_path / "a.ply", torus_knot(20))
    samples = noise(300)
    write_wav(tmp_path / "speech.wav", samples.tobytes())
    films = []
    for lengths in ([0.4], [0.1, 0.3]):
        segments = [{"path": "a.ply", "seconds": seconds} for seconds in lengths]
        scene = {"models": [{"segments": segments, "capacity": 20}], "timeline": {"fps": 10}}
        scene["sound"] = {"path": "speech.wav", "start": 0.1}  # type: ignore[assignment]
        (tmp_path / "scene.json").write_text(json.dumps(scene))
        words = ("render", "scene.json", "-o", "film.mp4", "--size", "24x16")
        completed = gsgen_here(*words, cwd=tmp_path)
        assert completed.code == 0, completed.err
        films.append((tmp_path / "film.mp4").read_bytes())
    assert films[0] == films[1]
    assert films[0].endswith(bytes(200) + samples.tobytes() + bytes(2 * (500 - 400)))
    completed = gsgen_here(*words, "--fps", "30", cwd=tmp_path)
    assert "the film is silent: it lasts" in completed.err
    assert b"soun" not in (tmp_path / "film.mp4").read_bytes()
    (tmp_path / "scene.json").write_text(json.dumps(scene | {"sound": {"path": "speech.mp3"}}))
    completed = gsgen_here(*words, cwd=tmp_path)
    assert (completed.code, "speech.mp3 is no .wav file" in completed.err) == (0, True)
