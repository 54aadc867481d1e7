// A robot loop that stops: it moves until something touches the skin or the loop is blind, and moves on when the skin
// has been untouched for some frames. Call your own robot in `drive`.
//
//     stop [ENDPOINT [CALM_FRAMES]]
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>

#include <eitskin.hpp>

namespace {

std::atomic<bool> running{true};

// Stands in for a robot's drive; prints when it was called, in ns of the clock of the runtime's stamps.
void drive(bool go, const char *why) {
    std::printf("%s %lld %s\n", go ? "go" : "stop", static_cast<long long>(eitskin::now_ns()), why);
    std::fflush(stdout);
}

}  // namespace

int main(int count, char **words) {
    std::signal(SIGINT, [](int) { running = false; });
    std::signal(SIGTERM, [](int) { running = false; });
    try {
        eitskin::Options options;
        options.all = true;  // a touch of one frame counts
        if (count > 1) options.endpoint = words[1];
        const int calm_frames = count > 2 ? std::atoi(words[2]) : 20;  // 0.1 s at 200 frames/s
        zmq::context_t context;
        eitskin::Subscriber skin(context, options);
        eitskin::Frame frame;
        bool moving = false, blind = false;
        for (int calm = 0; running;) {
            if (!skin.next(frame)) {
                if (!blind && running) drive(false, skin.why());
                moving = false, blind = true, calm = 0;
            } else if (!frame.touches.empty()) {
                char why[40];
                std::snprintf(why, sizeof why, "touched %.2f ms ago", 1e3 * frame.age_s());
                if (moving) drive(false, why);
                moving = blind = false, calm = 0;
            } else if (blind = false, !moving && ++calm >= calm_frames) {
                drive(true, "untouched");
                moving = true;
            }
        }
    } catch (const eitskin::Error &error) {
        std::fprintf(stderr, "stop: %s\n", error.what());
        return 1;
    }
    return 0;
}
