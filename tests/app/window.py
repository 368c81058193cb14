# SPDX-License-Identifier: GPL-3.0-or-later
"""The real program in a window on a virtual display, driven by mouse and keyboard.

Blender and the X tools come from PATH, or from a root folder that TIMESCALE_CHROOT
names (chroot.sh makes one). A script in the program answers questions: `ask` sends it
lines of Python and returns what they leave in `result`.
"""

import contextlib
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

TOOLS = ("blender", "Xvfb", "xdotool", "import", "convert")
SIZE = (1400, 900)
# Software OpenGL and two cores: a slow start is none.
PATIENCE = 60

REMOTE = """
import json, sys, traceback
from pathlib import Path
import bpy

FOLDER = Path(__file__).parent
STATE = {"next": 0}

def listen():
    path = FOLDER / f"ask-{STATE['next']}.py"
    if path.exists():
        names = {"bpy": bpy, "result": None}
        try:
            exec(path.read_text(), names)
            answer = {"result": names["result"]}
        except BaseException:
            answer = {"error": traceback.format_exc()}
        reply = FOLDER / f"answer-{STATE['next']}.json"
        reply.with_suffix(".part").write_text(json.dumps(answer))
        reply.with_suffix(".part").rename(reply)
        STATE["next"] += 1
    return 0.05

bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(listen, first_interval=1.0, persistent=True)
"""

# Names that every question may use.
COMMON = """
window = bpy.context.window_manager.windows[0]
area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
region = next(r for r in area.regions if r.type == "WINDOW")
sidebar = next(r for r in area.regions if r.type == "UI")
"""


def root() -> Path:
    """The root folder that the program runs in."""
    return Path(os.environ.get("TIMESCALE_CHROOT", "/"))


def missing() -> list[str]:
    """Tools that are not there."""
    if root() == Path("/"):
        return [tool for tool in TOOLS if shutil.which(tool) is None]
    if os.geteuid() != 0:
        return ["the rights of root"]
    return [tool for tool in TOOLS if not os.path.lexists(root() / "usr/bin" / tool)]


class Window:
    """Blender with the extension installed, on a display of its own."""

    def __init__(self, package: Path) -> None:
        self.chroot = root() != Path("/")
        self.folder = Path(tempfile.mkdtemp(prefix="window-", dir=root() / "tmp"))
        self.inside = Path("/") / self.folder.relative_to(root())
        self.asked = 0
        self._mounts = contextlib.ExitStack()
        if self.chroot:
            self._mount()
        shutil.copy(package, self.folder / "extension.zip")
        (self.folder / "remote.py").write_text(REMOTE)
        self.environment = {
            "HOME": str(self.inside),
            "PATH": "/usr/local/bin:/usr/bin:/bin",
            "BLENDER_USER_RESOURCES": str(self.inside / "profile"),
            "LIBGL_ALWAYS_SOFTWARE": "1",
        }
        (self.folder / "profile").mkdir()
        self._run(
            "blender --command extension install-file -r user_default --enable"
            f" {self.inside}/extension.zip"
        )
        self.server = self._serve()
        self.log = (self.folder / "blender.log").open("w")
        self.blender = self._start(
            "blender", "--window-geometry", "0", "0", *map(str, SIZE),
            "--python", f"{self.inside}/remote.py",
        )  # fmt: skip

    # Talking

    def ask(self, code: str, patience: float = PATIENCE) -> Any:
        """Run lines of Python in the program; return what they leave in `result`."""
        path = self.folder / f"ask-{self.asked}.py"
        reply = self.folder / f"answer-{self.asked}.json"
        path.with_suffix(".part").write_text(COMMON + code)
        path.with_suffix(".part").rename(path)
        self.asked += 1
        self.wait(reply.exists, patience, f"an answer to {code!r}")
        answer = json.loads(reply.read_text())
        assert "error" not in answer, answer.get("error")
        return answer["result"]

    def wait(self, happened, patience: float = PATIENCE, what: str = "it") -> None:
        """Wait until something is true, and not much longer than one can bear."""
        end = time.monotonic() + patience
        while not happened():
            assert self.blender.poll() is None, f"Blender ended: {self.said()}"
            assert time.monotonic() < end, f"waited in vain for {what}: {self.said()}"
            time.sleep(0.05)

    def wait_for(self, expression: str, patience: float = PATIENCE) -> None:
        """Wait until an expression of the program is true."""
        self.wait(
            lambda: self.ask(f"result = bool({expression})"), patience, expression
        )

    def said(self) -> str:
        """The last lines that Blender printed."""
        return (self.folder / "blender.log").read_text()[-2000:]

    # Mouse, keyboard, pictures

    def move(self, x: float, y: float) -> None:
        """Move the mouse to a place in Blender's coordinates, from the lower left."""
        self._run(f"xdotool mousemove {x:.0f} {SIZE[1] - y:.0f}")

    def click(self, x: float, y: float) -> None:
        """Click there."""
        self.move(x, y)
        time.sleep(0.3)
        self._run("xdotool click 1")

    def key(self, *names: str) -> None:
        """Press keys, with the mouse where it is."""
        for name in names:
            self._run(f"xdotool key {name}")
            time.sleep(0.2)

    def type(self, text: str) -> None:
        """Type text."""
        self._run(f"xdotool type --delay 40 '{text}'")
        time.sleep(0.3)

    def center(self) -> tuple[float, float]:
        """The middle of the 3D viewport."""
        return self.ask(
            "result = region.x + region.width / 2, region.y + region.height / 2"
        )

    def open_sidebar(self, tab: str = "Time-Scale") -> None:
        """Show a tab of the sidebar, wide enough to read."""
        self.ask("area.spaces.active.show_region_ui = True")
        time.sleep(0.5)
        self.ask(f"sidebar.active_panel_category = {tab!r}; area.tag_redraw()")
        time.sleep(0.5)

    def find_button(self, operator: str) -> tuple[float, float]:
        """Where the button of an operator is in the sidebar, by hovering down it."""
        x, low, high = self.ask(
            "result = sidebar.x + sidebar.width * 0.45, sidebar.y, "
            "sidebar.y + sidebar.height"
        )
        y = high - 20
        while y > low:
            self.move(x, y)
            time.sleep(0.12)
            # A button stays active for a moment after the mouse has left it.
            if self._hovers(operator) and (time.sleep(0.3) or self._hovers(operator)):
                return x, y
            y -= 10
        raise AssertionError(f"no button of {operator} in the sidebar")

    def _hovers(self, operator: str) -> bool:
        return self.ask(HOVERED).startswith(f"bpy.ops.{operator}(")

    def press(self, operator: str) -> None:
        """Click the button of an operator."""
        self.click(*self.find_button(operator))

    def picture(self, path: Path, options: str = "") -> Path:
        """Take a picture of the display, without a tooltip in the way.

        The options are those of ImageMagick's convert.
        """
        x, y = self.center()
        self.move(x, y / 2)
        self.ask("for a in window.screen.areas: a.tag_redraw()")
        time.sleep(1.0)
        self._run(
            f"import -window root shot.png && convert shot.png {options} shot.png"
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(self.folder / "shot.png", path)
        return path

    def saturation(self) -> float:
        """How colorful the middle of the 3D viewport is, from 0 (gray) to 1.

        Of the most colorful sixteenth of the pixels: outlines are fewer, and an
        object that fills the view has more.
        """
        x, y = self.center()
        self.move(x, y / 2)
        self.ask("for a in window.screen.areas: a.tag_redraw()")
        time.sleep(1.0)
        size = 300
        left, top = x - size / 2, SIZE[1] - y - size / 2
        crop = f"-crop {size}x{size}+{left:.0f}+{top:.0f} +repage -resize 16x16"
        self._run(
            f"import -window root seen.png && convert seen.png {crop} -depth 8 rgb:seen"
        )
        pixels = (self.folder / "seen").read_bytes()
        triples = zip(pixels[::3], pixels[1::3], pixels[2::3], strict=True)
        found = sorted((max(c) - min(c)) / max(1, *c) for c in triples)
        return found[-16]

    # The life of it

    def quit(self, patience: float = 20) -> None:
        """End Blender as a user does, and wait until it is gone."""
        self.ask("bpy.app.timers.register(bpy.ops.wm.quit_blender)")
        self.blender.wait(patience)

    def close(self) -> None:
        """End what still runs, and leave nothing behind."""
        for process in (self.blender, self.server):
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
        self.log.close()
        self._mounts.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _mount(self) -> None:
        """Give the root folder the system's devices while the window is open."""
        for place, options in (
            ("proc", ["-t", "proc", "proc"]),
            ("dev", ["--bind", "/dev"]),
        ):
            target = str(root() / place)
            if not os.path.ismount(target):
                subprocess.run(["mount", *options, target], check=True)
                self._mounts.callback(subprocess.run, ["umount", "-l", target])

    def _command(self, *command: str) -> list[str]:
        prefix = ["chroot", str(root())] if self.chroot else []
        values = [f"{name}={value}" for name, value in self.environment.items()]
        return [*prefix, "env", "-i", *values, *command]

    def _run(self, line: str) -> None:
        command = self._command("sh", "-c", f"cd {self.inside} && {line}")
        run = subprocess.run(
            command, capture_output=True, text=True, timeout=120, check=False
        )
        assert run.returncode == 0, f"{line}\n{run.stdout}{run.stderr}"

    def _start(self, *command: str) -> subprocess.Popen:
        return subprocess.Popen(
            self._command(*command), stdout=self.log, stderr=subprocess.STDOUT
        )

    def _serve(self) -> subprocess.Popen:
        """Start a display on a number that is free."""
        read, write = os.pipe()
        screen = f"{SIZE[0]}x{SIZE[1]}x24"
        server = subprocess.Popen(
            self._command(
                "Xvfb",
                "-displayfd",
                str(write),
                "-screen",
                "0",
                screen,
                "+extension",
                "GLX",
                "-nolisten",
                "tcp",
            ),
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as pipe:
            self.environment["DISPLAY"] = ":" + pipe.readline().strip()
        return server


# The button under the mouse says what it would run only by way of the clipboard.
HOVERED = """
manager = bpy.context.window_manager
manager.clipboard = ""
with bpy.context.temp_override(window=window, area=area, region=sidebar):
    if bpy.ops.ui.copy_python_command_button.poll():
        bpy.ops.ui.copy_python_command_button()
result = manager.clipboard
"""
