"""A session on the text client's screen, driven through Textual's pilot."""

from contextlib import asynccontextmanager

import cv2
import numpy as np
from hmi_fakes import view

from fleetpose.hmi_client.model.records import Picture
from fleetpose.hmi_client.tui.app import FleetApp


def picture(robot, seq=7, width=640, height=480):
    image = np.full((height, width, 3), 90, np.uint8)
    cv2.circle(image, (width // 2, height // 2), 60, (0, 0, 255), -1)
    return Picture(view(robot, seq), cv2.imencode(".jpg", image)[1].tobytes(), 1, 0.0)


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@asynccontextmanager
async def screen(session, size=(160, 50)):
    app = FleetApp({"demo": session})
    async with app.run_test(size=size) as pilot:
        app.tick()
        await pilot.pause()
        yield app, pilot


def text(panel):
    return "\n".join(strip.text for strip in panel._strips).replace("\u00a0", " ")


async def press(pilot, *keys):
    await pilot.press(*keys)
    pilot.app.view.desk.settle()
    pilot.app.tick()
    await pilot.pause()


async def selected(session, pilot, **size):
    session.select("r1", "r2")
    session.on_picture(picture("r1", **size)), session.on_picture(picture("r2", **size))
    pilot.app.tick()
    pilot.app.view.give_keys(pilot.app.images[0])
    pilot.app.tick()
    await pilot.pause()
