"""A server's side of a conversation in lines of text: the dashboard's and the gripper's."""

from __future__ import annotations

from abc import ABC, abstractmethod


class LineConversation(ABC):
    """Answers whole lines, in any pieces they arrive in.

    Args:
        longest: bytes after which a line without an end ends the conversation.
    """

    def __init__(self, longest: int) -> None:
        self._longest, self._rest = longest, b""
        self.ended = False

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the client and return what to answer; after the end of the conversation, nothing."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        answers = b""
        for line in lines:
            if self.ended:
                return answers
            answers += self.answer(line.decode("utf-8", "replace").strip())
        self.ended = self.ended or len(self._rest) > self._longest
        return answers

    @abstractmethod
    def answer(self, line: str) -> bytes:
        """The answer to one line, with whatever ends it."""
