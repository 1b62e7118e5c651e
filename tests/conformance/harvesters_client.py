"""Plain harvesters behind a pipe: one JSON request a line on stdin, one JSON answer a line on stdout.

A process of its own, since the GenTL binding holds the interpreter lock while it waits. It knows nothing of this
project: any GenTL producer may be opened with it.
"""

import base64
import json
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from genicam.gentl import TimeoutException
from harvesters.core import Harvester, ImageAcquirer


class Client:
    """One harvester with at most one acquirer."""

    def __init__(self) -> None:
        self._harvester: Harvester | None = None
        self._acquirer: ImageAcquirer | None = None

    @property
    def _nodes(self) -> Any:
        return self._acquirer.remote_device.node_map

    def add(self, cti: str) -> None:
        self._harvester = Harvester()
        self._harvester.add_file(cti, check_existence=True, check_validity=True)

    def devices(self) -> list[dict[str, Any]]:
        self._harvester.update()
        keys = ("id_", "vendor", "model", "serial_number", "tl_type", "access_status")
        return [{key: info.property_dict[key] for key in keys} for info in self._harvester.device_info_list]

    def create(self, **search: str) -> None:
        self._acquirer = self._harvester.create(search)

    def get(self, name: str) -> Any:
        return self._nodes.get_node(name).value

    def limits(self, name: str) -> list[float]:
        node = self._nodes.get_node(name)
        return [node.min, node.max]

    def set(self, name: str, value: Any) -> None:
        self._nodes.get_node(name).value = value

    def execute(self, name: str) -> None:
        self._nodes.get_node(name).execute()

    def has(self, name: str) -> bool:
        return self._nodes.has_node(name)

    def module_nodes(self) -> dict[str, Any]:
        return {
            "system": self._acquirer.system.node_map.TLVendorName.value,
            "interface": self._acquirer.interface.node_map.InterfaceDeviceCount.value,
            "device": self._acquirer.device.node_map.DeviceSerialNumber.value,
            "stream": self._acquirer.data_streams[0].node_map.StreamID.value,
        }

    def start(self, num_buffers: int = 4) -> None:
        self._acquirer.num_buffers = num_buffers
        self._acquirer.start()

    def fetch(self, timeout: float = 5.0) -> dict[str, Any] | None:
        try:
            with self._acquirer.fetch(timeout=timeout) as buffer:
                component = buffer.payload.components[0]
                return {
                    "frame_id": buffer.module.frame_id,
                    "timestamp_ns": buffer.timestamp_ns,
                    "format": component.data_format,
                    "shape": [component.height, component.width],
                    "offset": [component.y_offset, component.x_offset],
                    "padding": component.x_padding,
                    "dtype": str(component.data.dtype),
                    "raw": base64.b64encode(bytes(buffer.module.raw_buffer)).decode(),
                    "data": base64.b64encode(component.data.tobytes()).decode(),
                }
        except TimeoutException:
            return None

    def fetch_any(self) -> dict[str, Any]:
        """Next buffer, complete or not, past harvesters' own judgement."""
        (monitor,) = self._acquirer._new_buffer_event_monitor_dict.values()
        monitor.update_event_data(5000)
        buffer = monitor.buffer
        answer = {
            "frame_id": buffer.frame_id,
            "complete": buffer.is_complete(),
            "filled": buffer.size_filled,
            "size": buffer.size,
            "rows": buffer.delivered_image_height,
        }
        buffer.parent.queue_buffer(buffer)
        return answer

    def counts(self) -> dict[str, int]:
        stream = self._acquirer.data_streams[0]
        return {
            "delivered": stream.num_delivered,
            "underruns": stream.num_underrun,
            "lost": stream.node_map.StreamLostFrameCount.value,
            "announced": stream.num_announced,
            "grabbing": stream.is_grabbing(),
        }

    def stop(self) -> None:
        self._acquirer.stop()

    def destroy(self) -> None:
        self._acquirer.destroy()
        self._acquirer = None

    def reset(self) -> None:
        self._harvester.reset()
        self._harvester = None

    def resources(self) -> dict[str, int]:
        shared = sum(b"irpmd camera frames" in line for line in Path("/proc/self/maps").read_bytes().splitlines())
        return {
            "descriptors": sum(1 for _ in Path("/proc/self/fd").iterdir()),
            "threads": sum(1 for _ in Path("/proc/self/task").iterdir()),
            "python_threads": threading.active_count(),
            "rings": shared,
        }


def main() -> None:
    client = Client()
    for line in sys.stdin:
        request = json.loads(line)
        method: Callable[..., Any] = getattr(client, request["call"])
        try:
            answer = {"result": method(*request["arguments"], **request["options"])}
        except Exception as error:
            answer = {"error": type(error).__name__, "text": str(error)}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
