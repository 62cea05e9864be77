"""Recordings: their order, their times, and what is refused instead of left out."""

import io
import os
import tempfile
from contextlib import contextmanager, nullcontext
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from refusals import refused

from dirl.sources import video
from dirl.sources.video import Recording, photo_field_of_view, read_photo


@contextmanager
def run_here(command, **_):
    """In place of `subprocess.Popen`: the program runs in this process, which has imported what it needs."""
    console = os.dup(1)
    with tempfile.TemporaryFile() as answers:
        os.dup2(answers.fileno(), 1)
        try:
            exec(command[-1], {})
        finally:
            os.dup2(console, 1)
            os.close(console)
        answers.seek(0)
        yield SimpleNamespace(stdout=answers, wait=lambda: 0)


@pytest.fixture
def here(monkeypatch):
    """Read recordings in the process of the test, where what reads them has no limits."""
    monkeypatch.setattr(video.subprocess, "Popen", run_here)
    monkeypatch.setattr(video, "limit", lambda *_: None)


WIDE, HIGH = 64, 48


def picture(value):
    image = np.full((HIGH, WIDE, 3), value, np.uint8)
    image[10:30, 10:20] = 255 - value
    return image


def shades(frames):
    return [int(frame.image[0, 0, 0]) for frame in frames]


def test_images_are_in_the_order_in_which_people_number_them_and_none_is_left_out_that_is_not_read(tmp_path):
    folder = tmp_path / "walk"
    folder.mkdir()
    for number in range(12):
        Image.fromarray(picture(10 * number)).save(folder / f"{number}.png")
    (folder / "notes.txt").write_text("a walk")
    recording = Recording(folder, every=0.5)
    assert shades(recording) == [10 * number for number in range(12)]
    assert [frame.time for frame in recording][:3] == [0.0, 0.5, 1.0]
    assert (recording.count, recording.left_out) == (12, ["notes.txt"])
    (folder / "1.heic").write_bytes(b"")
    refused(r"1\.heic \(1 of this kind\)", Recording, folder)
    (folder / "1.heic").unlink()
    (folder / "1.png").write_bytes((folder / "0.png").read_bytes()[:60])
    refused(r"1\.png: ", lambda: list(Recording(folder)))
    Image.fromarray(np.full((HIGH, WIDE), 40000, np.uint16)).save(folder / "1.png")
    refused("16 bits", lambda: list(Recording(folder)))
    refused("holds no images", Recording, tmp_path)
    os.mkfifo(tmp_path / "pipe.mp4")
    refused("there is no such", Recording, tmp_path / "pipe.mp4")


def test_photos_are_upright_and_tell_their_field_of_view(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera stood upright
    exif.get_ifd(0x8769)[0xA405] = 26
    file = tmp_path / "photo.jpg"
    Image.new("RGB", (800, 600)).save(file, exif=exif)
    assert read_photo(file).shape == (480, 360, 3)
    # As wide from corner to corner as 26 mm on film, 79.5 degrees, of which an upright photo's width is three fifths.
    assert photo_field_of_view(file) == pytest.approx(53.1, abs=0.1)
    exif.get_ifd(0x8769)[0xA405] = 1  # of no camera
    Image.new("RGB", (800, 600)).save(file, exif=exif)
    assert photo_field_of_view(file) is None
    Image.new("RGB", (800, 600)).save(file)
    assert photo_field_of_view(file) is None


def make_video(file, times, codec="mpeg4", pixels="yuv420p"):
    """A video of pictures that grow lighter, at times in seconds."""
    av = pytest.importorskip("av")
    with av.open(str(file), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = WIDE, HIGH, pixels, 1_000_000
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, time in enumerate(times):
            frame = av.VideoFrame.from_ndarray(picture(10 * number), format="rgb24")
            frame.pts, frame.time_base = round(1000 * time), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return file


def test_frames_of_a_video_are_chosen_by_their_time_stamps(tmp_path):
    # Ten frames in two seconds, then one a second: nothing is repeated to fill the gaps.
    times = [0.2 * number for number in range(10)] + [2 + number for number in range(10)]
    frames = list(Recording(make_video(tmp_path / "walk.mkv", times), every=0.4))
    assert np.allclose([frame.time for frame in frames], [0, 0.4, 0.8, 1.2, 1.6, *range(2, 12)], atol=0.01)
    assert abs(np.array(shades(frames)) - [0, 20, 40, 60, 80, *range(100, 200, 10)]).max() <= 3
    assert frames[0].image.shape == (HIGH, WIDE, 3)
    deep = make_video(tmp_path / "deep.mkv", [0, 1, 2], "ffv1", "yuv420p10le")  # of ten bits a channel
    assert abs(np.array(shades(Recording(deep))) - [0, 10, 20]).max() <= 2


@pytest.mark.usefixtures("here")
def test_a_video_that_is_cut_off_texts_and_lists_of_other_files_are_refused(tmp_path):
    file = make_video(tmp_path / "walk.mp4", [0.2 * number for number in range(20)])
    assert 3 <= len(list(Recording(file, every=1.0))) <= 5
    texts = {
        "notes.txt": "a text that ffmpeg would draw\n" * 40,
        "list.mp4": "ffconcat version 1.0\nfile walk.mp4\n",
        "list.m3u8": "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nwalk.mp4\n#EXT-X-ENDLIST\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        refused("is no video that is read", Recording, tmp_path / name)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) * 2 // 3])  # what is at its end says where the frames are
    refused("is no video that is read", Recording, file)
    file.write_bytes(whole[:1000] + bytes(200) + whole[1200:])
    refused("is damaged after", lambda: list(Recording(file)))


@pytest.mark.usefixtures("here")
def test_what_threads_of_ffmpeg_say_of_damage_at_once_is_one_line(tmp_path, monkeypatch):
    file = make_video(tmp_path / "walk.mp4", [0, 1])
    said = [(16, "h264", "no frame!\nerror while decoding\n")]
    monkeypatch.setattr("av.logging.Capture", lambda **_: nullcontext(said))
    refused(r"is damaged after 2 frames \(no frame! error while decoding\)", lambda: list(Recording(file)))


@pytest.mark.usefixtures("here")
def test_a_video_of_a_camera_held_upright_is_turned(tmp_path):
    file = make_video(tmp_path / "walk.mp4", [0, 1])
    matrix = [0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30]  # of its track: a quarter to the right
    content = file.read_bytes()
    at = content.index(b"tkhd") + 44
    file.write_bytes(content[:at] + np.array(matrix, ">i4").tobytes() + content[at + 36 :])
    (turned, _), mark = list(Recording(file)), picture(0)[10:30, 10:20]
    assert turned.image.shape == (WIDE, HIGH, 3)
    assert abs(turned.image[10:20, HIGH - 30 : HIGH - 10].astype(int) - mark.max()).mean() < 30


@pytest.fixture(scope="module")
def stores():
    """The messages of ROS 2 and of ROS 1."""
    typesys = pytest.importorskip("rosbags.typesys")
    return [typesys.get_typestore(version) for version in (typesys.Stores.ROS2_HUMBLE, typesys.Stores.ROS1_NOETIC)]


def write_bag(path, stores, kind, encoding="rgb8", cameras=("/camera",)):
    """A bag of ten images of each camera, half a second apart, and odometry that goes a metre with each."""
    from rosbags import rosbag1, rosbag2

    first = kind == "bag"
    store, plugin = stores[first], rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
    of, serialize = store.types, store.serialize_ros1 if first else store.serialize_cdr
    image_type = "sensor_msgs/msg/CompressedImage" if encoding == "jpeg" else "sensor_msgs/msg/Image"
    types = {"/odom": "nav_msgs/msg/Odometry", **dict.fromkeys(cameras, image_type)}
    with rosbag1.Writer(path) if first else rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in types.items()}
        for number in range(10):
            stamp = of["builtin_interfaces/msg/Time"](number, 0)
            header = of["std_msgs/msg/Header"](*([number] if first else []), stamp, "map")
            point = of["geometry_msgs/msg/Point"](float(number), 2.0, 0.0)
            turn = of["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
            pose = of["geometry_msgs/msg/PoseWithCovariance"](of["geometry_msgs/msg/Pose"](point, turn), np.zeros(36))
            zero = of["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
            twist = of["geometry_msgs/msg/TwistWithCovariance"](of["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36))
            odometry = of["nav_msgs/msg/Odometry"](header, "base", pose, twist)
            pixels = picture(10 * number) // np.array([1, 1, 2], np.uint8)  # less blue than red
            if encoding == "jpeg":
                Image.fromarray(pixels).save(buffer := io.BytesIO(), "JPEG")
                image = of[image_type](header, encoding, np.frombuffer(buffer.getvalue(), np.uint8))
            else:
                data = np.ascontiguousarray(pixels[..., ::-1] if encoding == "bgr8" else pixels).reshape(-1)
                image = of[image_type](header, HIGH, WIDE, encoding, 0, 3 * WIDE, data)
            for topic, connection in connections.items():
                at = 10**9 + number * 5 * 10**8 - (topic == "/odom")
                writer.write(connection, at, serialize(odometry if topic == "/odom" else image, types[topic]))
    return path


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(("kind", "encoding"), [("bag", "rgb8"), ("sqlite", "bgr8"), ("mcap", "jpeg")])
def test_bags_of_ros_1_and_2_are_read_with_their_odometry(tmp_path, stores, kind, encoding):
    path = write_bag(tmp_path / ("walk.bag" if kind == "bag" else "walk"), stores, kind, encoding)
    paths = [path, *path.glob("*.mcap")] if path.is_dir() else [path]
    for one in paths:
        frames = list(Recording(one, every=1.0))
        assert [frame.time for frame in frames] == [0, 1, 2, 3, 4]
        assert abs(np.array(shades(frames)) - [0, 20, 40, 60, 80]).max() <= 3
        assert np.allclose([frame.place for frame in frames], [(number, 2, 90) for number in (0, 2, 4, 6, 8)])


@pytest.mark.usefixtures("here")
def test_of_several_topics_one_is_chosen_and_what_is_no_bag_is_refused(tmp_path, stores):
    path = write_bag(tmp_path / "walk", stores, "mcap", cameras=("/camera", "/rear"))
    refused("choose topic= of /camera, /rear", lambda: list(Recording(path)))
    assert len(list(Recording(path, topic="/rear"))) == 5
    refused("has no topic /front of Image .*; it has /camera", lambda: list(Recording(path, topic="/front")))
    (tmp_path / "cut.mcap").write_bytes(next(path.glob("*.mcap")).read_bytes()[:500])
    refused("is no bag that is read", Recording, tmp_path / "cut.mcap")
    odd = write_bag(tmp_path / "odd", stores, "sqlite", "32FC1")
    refused("encoding 32FC1", lambda: list(Recording(odd)))
