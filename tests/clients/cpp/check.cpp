// Prints what eitskin.hpp makes of a stream, for tests/clients/test_header.py.
//
//     check frames ENDPOINT COUNT newest|all maps|touches PAUSE_MS   each frame, then allocations and losses
//     check blind ENDPOINT LIMIT_S COUNT                             so many lines: seen, or why there is no frame
//     check cloud ENDPOINT PIXELS                                    the revision of a cloud at z = 7 mm
//     check load FILE                                                of messages behind their sizes
#include <chrono>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <new>
#include <string>
#include <thread>

#include <eitskin.hpp>

static thread_local unsigned long allocations = 0;

void *operator new(std::size_t size) {
    ++allocations;
    if (void *found = std::malloc(size)) return found;
    throw std::bad_alloc();
}
void *operator new[](std::size_t size) { return operator new(size); }
void operator delete(void *at) noexcept { std::free(at); }
void operator delete[](void *at) noexcept { std::free(at); }
void operator delete(void *at, std::size_t) noexcept { std::free(at); }
void operator delete[](void *at, std::size_t) noexcept { std::free(at); }

static void print(const eitskin::Frame &frame) {
    double sum = 0.0;
    for (std::size_t row = 0; row < frame.rows; ++row)
        for (std::size_t column = 0; column < frame.columns; ++column)
            sum += static_cast<double>(frame.map(row, column));
    std::printf("frame %llu %llu %d %llu %llu %llu %.9g %.*s %zu\n", static_cast<unsigned long long>(frame.number),
                static_cast<unsigned long long>(frame.sequence), frame.touched,
                static_cast<unsigned long long>(frame.cloud), static_cast<unsigned long long>(frame.read_ns),
                static_cast<unsigned long long>(frame.rows * frame.columns), sum,
                static_cast<int>(frame.solver.size()), frame.solver.data(), frame.events.size());
    for (const auto &touch : frame.touches)
        std::printf("touch %llu %u %.9g %.9g %.9g %.9g %.9g %.9g %.9g %.9g\n",
                    static_cast<unsigned long long>(frame.number), touch.id, static_cast<double>(touch.age_s),
                    static_cast<double>(touch.centre_mm[0]), static_cast<double>(touch.centre_mm[1]),
                    static_cast<double>(touch.area_mm2), static_cast<double>(touch.peak),
                    static_cast<double>(touch.place_mm[2]), static_cast<double>(touch.normal[2]),
                    static_cast<double>(touch.surface_mm2));
    std::fflush(stdout);
}

static int frames(eitskin::Options options, int count, int pause_ms) {
    zmq::context_t context;
    eitskin::Subscriber skin(context, options);
    eitskin::Frame frame;
    unsigned long before = 0;
    for (int seen = 0; seen < count;) {
        if (!skin.next(frame)) continue;
        const unsigned long made = allocations;
        if (!seen++) before = made;
        print(frame);
        std::this_thread::sleep_for(std::chrono::milliseconds(pause_ms));
        before += allocations - made;  // those of printing are none of the header's
    }
    std::printf("allocations %lu lost %llu\n", allocations - before, static_cast<unsigned long long>(skin.lost()));
    return 0;
}

static int blind(eitskin::Options options, int count) {
    zmq::context_t context;
    eitskin::Subscriber skin(context, options);
    eitskin::Frame frame;
    for (std::string last, found; count;) {
        found = skin.next(frame) ? "seen" : skin.why();
        if (found == "seen" ? found == last : !frame.touches.empty() || frame.touched) continue;
        if (found != last && (last = found) != "") --count, std::printf("%s\n", found.c_str()), std::fflush(stdout);
    }
    return 0;
}

static int load(const char *path) {
    std::ifstream file(path, std::ios::binary);
    const std::string data{std::istreambuf_iterator<char>(file), {}};
    eitskin::Frame frame;
    for (std::size_t at = 0; at + 4 <= data.size();) {
        std::uint32_t size;
        std::memcpy(&size, data.data() + at, 4);
        zmq::message_t message(data.data() + at + 4, size);
        const char *wrong = frame.load(message, eitskin::now_ns(), "");
        if (wrong) std::printf("%s%s\n", wrong, frame.touches.empty() ? "" : ", with touches");
        else print(frame);
        at += 4 + size;
    }
    return 0;
}

int main(int count, char **words) {
    const std::string what = count > 1 ? words[1] : "";
    eitskin::Options options;
    if (count > 2) options.endpoint = words[2];
    try {
        if (what == "frames" && count == 7) {
            options.all = std::string(words[4]) == "all";
            options.maps = std::string(words[5]) == "maps";
            options.blind_s = 60.0;  // a busy runtime's old frames came, so they are not lost: print them too
            return frames(options, std::atoi(words[3]), std::atoi(words[6]));
        }
        if (what == "blind" && count == 5) {
            options.blind_s = std::atof(words[3]);
            return blind(options, std::atoi(words[4]));
        }
        if (what == "cloud" && count == 4) {
            const auto pixels = static_cast<std::size_t>(std::atoi(words[3]));
            std::vector<float> xyz(3 * pixels, 7.0f);
            for (std::size_t pixel = 0; pixel < pixels; ++pixel) {
                xyz[pixel] = (static_cast<float>(pixel % 45) + 0.5f) * 10.0f / 3.0f;
                xyz[pixels + pixel] = (static_cast<float>(pixel / 45) + 0.5f) * 10.0f / 3.0f;
            }
            zmq::context_t context;
            const auto revision = eitskin::send_cloud(context, xyz, {}, {}, words[2]);
            std::printf("cloud %llu\n", static_cast<unsigned long long>(revision));
            return 0;
        }
        if (what == "load" && count == 3) return load(words[2]);
    } catch (const eitskin::Error &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
    return 2;
}
