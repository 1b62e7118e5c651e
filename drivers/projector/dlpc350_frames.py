"""Messages of TI's DLPC350 over USB (programmer's guide DLPU010): written and read.

A message is `flags sequence lengthL lengthH CMD3 CMD2 data...`, its length that of command and data, in packets
of 64 bytes. Flag bit 7 reads, bit 6 asks for a reply; bit 5 in a reply is a refusal. A reply is `flags sequence
lengthL lengthH data...`.
"""

import struct

from drivers.errors import GarbledReply, Refused

VENDOR, PRODUCT = 0x0451, 0x6401
ENDPOINT_OUT, ENDPOINT_IN = 0x01, 0x81
PACKET_BYTES = 64
READ, WRITE, REFUSAL = 0xC0, 0x40, 0x20
_HEAD = struct.Struct("<BBH")


class StaleReply(Exception):
    """The reply to another message than the last one."""


def encode(command: int, sequence: int, data: bytes = b"", *, read: bool = False) -> list[bytes]:
    """Return a message as its packets.

    Parameters
    ----------
    command
        CMD2 and CMD3, as in 0x1A24.
    sequence
        Number of the message, 0 to 255.
    data
        What follows the command.
    read
        Ask, instead of write.
    """
    flags = READ if read else WRITE
    message = _HEAD.pack(flags, sequence, 2 + len(data)) + struct.pack("<H", command) + data
    message += bytes(-len(message) % PACKET_BYTES)
    return [message[at : at + PACKET_BYTES] for at in range(0, len(message), PACKET_BYTES)]


def decode(device: str, command: int, sequence: int, packet: bytes, *, read: bool = False) -> bytes:
    """Return the data of a reply.

    Raises
    ------
    Refused
        The controller refuses the command.
    GarbledReply
        It is no reply to such a message.
    StaleReply
        It is one to an earlier message.
    """
    if len(packet) < _HEAD.size:
        raise _garbled(device, packet)
    flags, answered, length = _HEAD.unpack_from(packet)
    if flags & ~REFUSAL not in (READ, WRITE) or length > len(packet) - _HEAD.size:
        raise _garbled(device, packet)
    if answered != sequence:
        raise StaleReply
    if flags & REFUSAL:
        raise Refused(device, f"the controller refuses command {command:04X}", "see the programmer's guide DLPU010")
    if flags != (READ if read else WRITE) or (read and not length):
        raise _garbled(device, packet)
    return packet[_HEAD.size : _HEAD.size + length]


def pattern_entry(number: int, bits: int, leds: int, *, swap: bool) -> bytes:
    """Return one entry of the pattern table, triggered by the controller itself.

    Parameters
    ----------
    number
        Which bits of the 24-bit image: counted in groups of `bits`, from the lowest of green over red to blue.
    leds
        Bit 0 red, bit 1 green, bit 2 blue.
    swap
        Take the next image.
    """
    return (number << 2 | bits << 8 | leds << 12 | swap << 18).to_bytes(3, "little")


def _garbled(device: str, packet: bytes) -> GarbledReply:
    return GarbledReply(device, f"no reply of a DLPC350: {packet[:16].hex(' ')}", "retry; look at the cable")
