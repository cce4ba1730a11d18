"""An HTTP server of one file on loopback, for tests of transfers that go wrong."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Server:
    """A server of one file, that can break off, forget, change and refuse."""

    def __init__(self, content):
        self.content, self.etag, self.breaks_after, self.ranges = content, '"one"', [], []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                outer.answer(self)

            def log_message(self, *_):
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.base = f"http://127.0.0.1:{self._server.server_port}"
        self.url = f"{self.base}/ardusub"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self._thread.start()

    def answer(self, request):
        if request.path != "/ardusub":
            request.send_error(404)
            return
        asked, condition = request.headers["Range"], request.headers["If-Range"]
        self.ranges.append(asked)
        begin = 0
        if asked is not None and condition == self.etag:
            begin = int(asked.removeprefix("bytes=").removesuffix("-"))
        if begin > len(self.content):
            request.send_error(416)
            return
        rest = self.content[begin:]
        request.send_response(206 if begin else 200)
        if begin:
            last = len(self.content) - 1
            request.send_header("Content-Range", f"bytes {begin}-{last}/{len(self.content)}")
        request.send_header("Content-Length", str(len(rest)))
        request.send_header("ETag", self.etag)
        request.end_headers()
        if self.breaks_after:
            rest = rest[: self.breaks_after.pop(0)]
        request.wfile.write(rest)

    def close(self):
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
