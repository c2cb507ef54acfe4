"""Reads WAV files: for inputs of the role ``audio``, and as the sound of a film.

The last sample of a frame's window is that of the moment that is drawn; before the recording there
are zeros (the section "Sound" of the specification's roles).
"""

__all__ = ["SOUND_SUFFIX", "film_sound", "read_sound", "sound_track"]

import wave
from fractions import Fraction
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.media.mp4 import Sound
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.sources.key_frames import SceneSound

SOUND_SUFFIX: Final = ".wav"
"""Suffix of files that hold the sound of a track."""

_MAX_BYTES: Final = 1 << 30  # of the windows of all frames
_MAX_DENOMINATOR: Final = 1000  # largest denominator of the ratio of two sample rates
_PCM_DTYPES: Final = {1: "u1", 2: "<i2", 3: "<i4", 4: "<i4"}  # 3 bytes are widened to 4
_MAX_RATE: Final = 768_000  # samples a second of the fastest converters
_FILM_RATE: Final = 48_000  # of faster recordings in films: rates of .mp4 files have 16 bits
_ARRAY_HINT: Final = "Compute the input yourself, and give an .npy of [frames, …]."


def sound_track(path: Path, spec: Input, shape: tuple[int, ...], fps: float) -> Track:
    """Return, for each frame of a video, the window of WAV samples that ends at the frame.

    Args:
        path: The file: PCM of 8, 16, 24 or 32 bits; the mean of its channels is taken.
        spec: The input. Sound of another sample rate is resampled to the input's.
        shape: Shape of the input, [S].
        fps: Frames per second of the video.

    Raises:
        ConfigInvalid: The input takes no samples of sound, or the file cannot be read.
    """
    where = f"--input {spec.name}={path}"
    if spec.role != "audio" or spec.convention == "mel" or len(shape) != 1 or spec.rate is None:
        expected = "mel energies" if spec.role == "audio" else f"the role {spec.role}"
        raise ConfigInvalid(
            f"a sound file cannot feed the input {spec.name!r}, which takes {expected}: "
            "expected an input of audio samples with a sampling rate",
            where=where,
            hint=_ARRAY_HINT,
        )
    samples, rate = read_sound(path)
    samples = _resample_audio(samples, rate, spec.rate)
    frames = max(1, int(np.ceil(len(samples) / spec.rate * fps)))
    if 4 * frames * shape[0] > _MAX_BYTES:
        raise ConfigInvalid(
            f"{frames:,} frames with {shape[0]:,} samples each take more than 1 GiB",
            where=where,
            hint="Cut the recording, or lower --fps.",
        )
    padded = np.concatenate([np.zeros(shape[0] - 1, np.float32), samples])
    last = np.minimum(np.rint(np.arange(frames) / fps * spec.rate), len(samples) - 1).astype(int)
    windows = np.lib.stride_tricks.sliding_window_view(padded, shape[0])[last]
    return Track(spec.name, windows, where)


def film_sound(sound: SceneSound, seconds: float) -> Sound:
    """Return what is heard in a film of some seconds: a recording at its place on the timeline.

    Before and after the recording there is silence; what is before 0 or after the end is cut off.

    Raises:
        ConfigInvalid: The recording cannot be read, or holds no sound.
    """
    samples, rate = read_sound(sound.path)
    if rate >= 1 << 16:
        samples, rate = _resample_audio(samples, rate, _FILM_RATE), _FILM_RATE
    heard = np.zeros(round(seconds * rate), np.float32)
    start = round(sound.start * rate)
    recorded = samples[max(-start, 0) : max(len(heard) - start, 0)]
    begin = max(start, 0)
    heard[begin : begin + len(recorded)] = recorded
    return Sound(samples=heard, rate=round(rate))


def read_sound(path: Path) -> tuple[Float32[np.ndarray, " n"], float]:
    """Read the samples of a WAV file, in [−1, 1), and its samples per second.

    Raises:
        ConfigInvalid: The file cannot be read, or holds no sound.
    """
    try:
        with wave.open(str(path), "rb") as file:
            channels, width = file.getnchannels(), file.getsampwidth()
            rate, data = file.getframerate(), file.readframes(file.getnframes())
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise ConfigInvalid(message, where=str(path)) from error
    except (wave.Error, EOFError) as error:
        hint = "Convert it to WAV with PCM samples."
        raise ConfigInvalid(f"is no WAV of PCM: {error}", where=str(path), hint=hint) from error
    if width not in _PCM_DTYPES or rate > _MAX_RATE:
        actual = f"has {8 * width} bits a sample and {rate:,} samples a second"
        expected = f"expected 8, 16, 24 or 32 bits, and at most {_MAX_RATE:,} samples a second"
        raise ConfigInvalid(f"{actual}, {expected}", where=str(path))
    data = data[: len(data) // (channels * width) * channels * width]
    if not data or not rate:
        raise ConfigInvalid("the file holds no samples of sound", where=str(path))
    if width == 3:  # little-endian 24 bits become the upper ones of 32
        padded = np.zeros((len(data) // 3, 4), np.uint8)
        padded[:, 1:] = np.frombuffer(data, np.uint8).reshape(-1, 3)
        numbers, width = padded.reshape(-1).view("<i4"), 4
    else:
        numbers = np.frombuffer(data, np.dtype(_PCM_DTYPES[width]))
    middle = 128 if width == 1 else 0  # 8 bits are unsigned
    audio_amplitudes = (numbers.astype(np.float64) - middle) / 2 ** (8 * width - 1)
    return audio_amplitudes.reshape(-1, channels).mean(axis=1).astype(np.float32), float(rate)


def _resample_audio(
    samples: Float32[np.ndarray, " n"], rate: float, target: float
) -> Float32[np.ndarray, " m"]:
    if rate == target:
        return samples
    from scipy.signal import resample_poly

    ratio = Fraction(target / rate).limit_denominator(_MAX_DENOMINATOR)
    resampled_audio = resample_poly(samples, ratio.numerator, ratio.denominator)
    return np.asarray(np.clip(resampled_audio, -1, 1), np.float32)
