// eitskin.hpp: touches, maps and control of an eitskin runtime for C++17, over ZeroMQ (libzmq and cppzmq).
//
//     zmq::context_t context;
//     eitskin::Subscriber skin(context);  // of `eitskin run` on this machine
//     eitskin::Frame frame;
//     while (running) {
//         if (!skin.next(frame)) stop(skin.why());      // blind: no frame in time, or only an old one
//         else if (!frame.touches.empty()) stop("touched");
//     }
//
// firmware_proto/SPEC.md, sections 7 and 8, defines the messages. Places are in mm, times in s or ns.
// A Subscriber and a Frame belong to one thread. After its first frame, `next` allocates no memory and throws nothing.
#pragma once

#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <unistd.h>
#include <zmq.hpp>

namespace eitskin {

// A wrong endpoint, missing keys, or a request that the runtime refused; the text says what to do.
struct Error : std::runtime_error { using std::runtime_error::runtime_error; };

// The clock of the runtime's stamps.
inline std::int64_t now_ns() {
    return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// CURVE keys, which TCP needs: the texts between quotes in the files of `eitskin doctor --make-curve-keys`.
struct Keys {
    std::string server;                  // public-key of server.key
    std::string own_public, own_secret;  // public-key and secret-key of client.key_secret
};

// "frames" or "control" of `eitskin run` without --publish and --control.
inline std::string default_endpoint(const std::string &name) {
    const char *session = std::getenv("XDG_RUNTIME_DIR");
    std::error_code ignored;
    const bool there = session && std::filesystem::is_directory(session, ignored);
    const std::string folder = there ? std::string(session) + "/eitskin" : "/tmp/eitskin-" + std::to_string(getuid());
    return "ipc://" + folder + "/" + name;
}

namespace detail {

// Reads MessagePack in place. What does not fit sets `wrong`; after that all is empty and 0.
class Reader {
  public:
    Reader(const void *data, std::size_t size) : rest_(static_cast<const char *>(data), size) {}

    bool wrong = false;

    std::uint64_t map() { return take(Kind::map); }
    std::uint64_t array() { return take(Kind::array); }
    std::uint64_t count() { return take(Kind::count); }
    bool boolean() { return take(Kind::boolean) != 0; }
    std::string_view text() { return bytes(take(Kind::text)); }
    std::string_view bin() { return bytes(take(Kind::bin)); }
    // Passes over a value of any kind.
    void skip(int depth = 0) {
        const auto [kind, value] = head();
        if (depth > 8) wrong = true;
        if (kind == Kind::text || kind == Kind::bin) bytes(value);
        if (kind == Kind::array || kind == Kind::map)
            for (std::uint64_t left = kind == Kind::map ? 2 * value : value; left && !wrong; --left) skip(depth + 1);
    }

  private:
    enum class Kind { other, boolean, count, text, bin, array, map };

    std::uint64_t take(Kind wanted) {
        const auto [kind, value] = head();
        wrong = wrong || kind != wanted;
        return wrong ? 0 : value;
    }
    // The kind of the next value, and the value itself or its size.
    std::pair<Kind, std::uint64_t> head() {
        const auto type = static_cast<unsigned>(number(1));
        if (type < 0x80) return {Kind::count, type};
        if (type < 0x90) return {Kind::map, type & 0x0f};
        if (type < 0xa0) return {Kind::array, type & 0x0f};
        if (type < 0xc0) return {Kind::text, type & 0x1f};
        if (type == 0xc0 || type >= 0xe0) return {Kind::other, 0};
        if (type == 0xc2 || type == 0xc3) return {Kind::boolean, type & 1};
        if (type >= 0xc4 && type <= 0xc6) return {Kind::bin, number(1u << (type - 0xc4))};
        if (type == 0xca || type == 0xcb) return {Kind::other, number(type == 0xca ? 4 : 8)};
        if (type >= 0xcc && type <= 0xd3) return {type < 0xd0 ? Kind::count : Kind::other, number(1u << (type & 3))};
        if (type >= 0xd9 && type <= 0xdb) return {Kind::text, number(1u << (type - 0xd9))};
        if (type >= 0xdc) return {type < 0xde ? Kind::array : Kind::map, number(type & 1 ? 4 : 2)};
        wrong = true;
        return {Kind::other, 0};
    }
    std::uint64_t number(std::size_t size) {  // big-endian
        std::uint64_t value = 0;
        for (const char one : bytes(size)) value = value << 8 | static_cast<unsigned char>(one);
        return value;
    }
    std::string_view bytes(std::uint64_t size) {
        wrong = wrong || size > rest_.size();
        const std::string_view found = rest_.substr(0, wrong ? 0 : size);
        rest_.remove_prefix(found.size());
        return found;
    }

    std::string_view rest_;
};

// What both kinds of socket set before they connect.
inline void connect(zmq::socket_t &socket, const std::string &endpoint, const std::optional<Keys> &keys) {
    if (endpoint.rfind("tcp://", 0) == 0 && !keys)
        throw Error(endpoint + " needs CURVE keys, even on this machine: set Options::keys");
    socket.set(zmq::sockopt::linger, 0);
    try {
        if (keys) {
            socket.set(zmq::sockopt::curve_serverkey, keys->server);
            socket.set(zmq::sockopt::curve_publickey, keys->own_public);
            socket.set(zmq::sockopt::curve_secretkey, keys->own_secret);
        }
        socket.connect(endpoint);
    } catch (const zmq::error_t &error) {
        throw Error(endpoint + " cannot be connected to: " + error.what() + "; expected ipc:///path or tcp://...");
    }
}

}  // namespace detail

// The bytes of a touch as the runtime sends it; SPEC.md, "Touches", says what each field means.
struct Touch {
    std::uint32_t id, parent;
    float age_s;
    float centre_mm[2], axes_mm[2], angle_rad, area_mm2, peak;
    float strength, confidence;                          // NaN while unknown
    float place_mm[3], normal[3], surface_mm2;           // on the surface of the cloud in use
    float error_mm[2], amplitude, log_likelihood_ratio;  // NaN unless touches were learned from presses
    float sign;                                          // 1 raises conductance, -1 lowers it, NaN while unknown
    float velocity_mm_s[2];                              // 0 while it rests; NaN from older runtimes
};
static_assert(sizeof(Touch) == 104, "a touch has 104 bytes");

// A list in place of a vector, which would allocate.
template <typename Item, std::size_t Most> struct List {
    std::array<Item, Most> items{};
    std::size_t count = 0;

    bool empty() const { return count == 0; }
    std::size_t size() const { return count; }
    const Item *begin() const { return items.data(); }
    const Item *end() const { return items.data() + count; }
};

// One frame. It owns its message, to which its texts and its map refer until the next frame is read into it.
class Frame {
  public:
    std::uint64_t number = 0, sequence = 0, age_us = 0, cloud = 0, touches_more = 0;
    std::uint64_t read_ns = 0, publish_ns = 0;  // of the runtime's machine
    std::int64_t received_ns = 0;               // of this one
    bool touched = false, same_host = false;
    std::string_view run, host, solver;
    List<Touch, 16> touches;
    List<std::string_view, 16> events, electrodes;
    std::uint64_t rows = 0, columns = 0;  // of the map; 0 without maps

    // The share of a pixel that is touched, or its probability: 0 to 1, row 0 at y = 0.
    float map(std::size_t row, std::size_t column) const {
        float value;
        std::memcpy(&value, map_.data() + 4 * (row * columns + column), sizeof value);
        return value;
    }

    // s since the scan; from another machine without the time on the network.
    double age_s() const {
        const std::int64_t since = now_ns() - (same_host ? static_cast<std::int64_t>(publish_ns) : received_ns);
        return 1e-6 * static_cast<double>(age_us) + 1e-9 * static_cast<double>(since > 0 ? since : 0);
    }

    // Reads a message and returns what is wrong with it; nullptr if it is a frame with touches.
    const char *load(zmq::message_t &message, std::int64_t at_ns, std::string_view this_host) {
        clear();
        std::swap(message_, message);
        received_ns = at_ns;
        const auto *wrong = fields(detail::Reader(message_.data(), message_.size()));
        if (wrong) clear();
        same_host = host == this_host;
        return wrong;
    }

    void clear() {  // leaves no touch behind, and no map
        touched = false;
        rows = columns = touches.count = events.count = electrodes.count = 0;
        map_ = run = host = solver = {};
    }

  private:
    const char *fields(detail::Reader in) {
        std::uint64_t version = 0, touch_bytes = 0, other_ns = 0;
        std::string_view touches_bin;
        bool listed = false;
        const bool alone = message_.size() && *static_cast<const unsigned char *>(message_.data()) == 0xdf;
        for (std::uint64_t left = in.map(); left && !in.wrong; --left) {
            const std::string_view key = in.text();
            if (key == "v") version = in.count();
            else if (version != (alone ? 2 : 1)) return "a frame of another version than this header reads; update it";
            else if (key == "n") number = in.count();
            else if (key == "seq") sequence = in.count();
            else if (key == "age_us") age_us = in.count();
            else if (key == "cloud") cloud = in.count();
            else if (key == "touched") touched = in.boolean();
            else if (key == "run") run = in.text();
            else if (key == "host") host = in.text();
            else if (key == "solver") solver = in.text();
            else if (key == "events") texts(in, events);
            else if (key == "electrodes") texts(in, electrodes);
            else if (key == "host_ns")
                for (std::uint64_t stamps = in.map(); stamps && !in.wrong; --stamps) {
                    const std::string_view stage = in.text();
                    (stage == "read" ? read_ns : stage == "publish" ? publish_ns : other_ns) = in.count();
                }
            else if (key == "shape" && in.array() == 2) rows = in.count(), columns = in.count();
            else if (key == "map") map_ = in.bin();
            else if (key == "touches") touches_bin = in.bin(), listed = true;
            else if (key == "touch_bytes") touch_bytes = in.count();
            else if (key == "touches_more") touches_more = in.count();
            else in.skip();
        }
        if (in.wrong || run.empty() || (alone && rows)) return "a message that is no frame";
        if (rows > 120 || columns > 120 || map_.size() != 4 * rows * columns) return "a map that is not of its size";
        if (!listed || (!alone && map_.empty())) return "a frame without touches: the runtime is older than they are";
        if (touch_bytes < 76 || touches_bin.size() % touch_bytes || touches_bin.size() / touch_bytes > 16)
            return "a list of touches that is not of its size";
        for (std::size_t at = 0; at < touches_bin.size(); at += touch_bytes) {
            Touch &touch = touches.items[touches.count++];
            touch.error_mm[0] = touch.error_mm[1] = touch.amplitude = touch.log_likelihood_ratio = touch.sign = NAN;
            touch.velocity_mm_s[0] = touch.velocity_mm_s[1] = NAN;
            std::memcpy(&touch, touches_bin.data() + at, touch_bytes < sizeof touch ? touch_bytes : sizeof touch);
        }
        return nullptr;
    }

    static void texts(detail::Reader &in, List<std::string_view, 16> &list) {
        for (std::uint64_t left = in.array(); left && !in.wrong; --left)
            if (list.count < list.items.size()) list.items[list.count++] = in.text();
            else in.skip();
    }

    zmq::message_t message_;
    std::string_view map_;
};

struct Options {
    std::string endpoint = default_endpoint("frames");
    bool all = false;            // every frame in order; else the newest
    bool maps = false;           // maps beside touches, six times the bytes
    double blind_s = 0.2;        // without a frame for so long, or with only an older one, `next` says blind
    std::optional<Keys> keys{};  // for TCP
};

class Subscriber {
  public:
    // Throws Error for an endpoint that makes no sense, or TCP without keys.
    explicit Subscriber(zmq::context_t &context, Options options = {})
        : options_(std::move(options)), socket_(context, zmq::socket_type::sub), heard_ns_(now_ns()) {
        std::ifstream("/proc/sys/kernel/random/boot_id") >> host_;
        socket_.set(zmq::sockopt::maxmsgsize, std::int64_t{73728});
        socket_.set(zmq::sockopt::rcvhwm, 2000);  // 10 s at 200 frames/s
        // Before it connects: a frame with a map begins with de, one without with df.
        if (options_.maps)
            for (const char *topic : {"eitskin/region/whole", "eitskin/always", "eitskin/touches"})
                socket_.set(zmq::sockopt::subscribe, topic);
        socket_.set(zmq::sockopt::subscribe, options_.maps ? "\xde" : "\xdf");
        detail::connect(socket_, options_.endpoint, options_.keys);
    }

    // Waits for the newest frame, or for the next one of all. Returns false if the program is blind: no frame came
    // within blind_s, or it is older than that, or a signal ended the wait. The frame is then empty; why() explains.
    bool next(Frame &frame) noexcept {
        const double longest_s = options_.blind_s;
        const std::int64_t end_ns = now_ns() + static_cast<std::int64_t>(1e9 * longest_s);
        const char *unusable = nullptr;
        for (std::int64_t left_ns; (left_ns = end_ns - now_ns()) > 0;) {
            if (!receive(static_cast<int>(left_ns / 1000000) + 1)) {
                if (zmq_errno() == EAGAIN) continue;
                return blind(frame, "the wait for %s ended: %s", endpoint(), zmq_strerror(zmq_errno()));
            }
            heard_ns_ = now_ns();
            if ((unusable = frame.load(message_, heard_ns_, host_))) continue;
            count(frame);
            if (const double age_s = frame.age_s(); age_s > longest_s)
                return blind(frame, "%s sent a frame that is %.3f s old, more than %g s", endpoint(), age_s, longest_s);
            return true;
        }
        reconnect();
        if (unusable) return blind(frame, "%s sent %s", endpoint(), unusable);
        return blind(frame, "no frame from %s within %g s: is `eitskin run` running there?", endpoint(), longest_s);
    }

    // Why the last `next` returned false.
    const char *why() const { return why_; }
    // Published frames that did not come, on purpose if only the newest is wanted. A frame that came too old did come.
    std::uint64_t lost() const { return lost_; }

  private:
    // Receives a message, and in mode newest the last of those that wait.
    bool receive(int wait_ms) {
        socket_.set(zmq::sockopt::rcvtimeo, wait_ms);
        if (zmq_msg_recv(message_.handle(), socket_.handle(), 0) < 0) return false;
        while (!options_.all && zmq_msg_recv(spare_.handle(), socket_.handle(), ZMQ_DONTWAIT) >= 0)
            std::swap(message_, spare_);
        return true;
    }

    void count(const Frame &frame) {
        if (frame.run == run_ && frame.number > number_) lost_ += frame.number - number_ - 1;
        std::snprintf(run_, sizeof run_, "%.*s", static_cast<int>(frame.run.size()), frame.run.data());
        number_ = frame.number;
    }

    // libzmq itself does not connect again to an address where bytes came that are none of its own.
    void reconnect() {
        if (now_ns() - heard_ns_ < 2000000000) return;
        zmq_disconnect(socket_.handle(), endpoint());
        zmq_connect(socket_.handle(), endpoint());
        heard_ns_ = now_ns();
    }

    template <typename... Values> bool blind(Frame &frame, const char *format, Values... values) {
        std::snprintf(why_, sizeof why_, format, values...);
        frame.clear();
        return false;
    }

    const char *endpoint() const { return options_.endpoint.c_str(); }

    Options options_;
    zmq::socket_t socket_;
    zmq::message_t message_, spare_;
    std::string host_;
    std::int64_t heard_ns_;
    std::uint64_t number_ = 0, lost_ = 0;
    char run_[132] = "", why_[320] = "";
};

// Tells the runtime where the sheet is, and returns the cloud's revision, which frame.cloud names from then on.
//
// xyz_mm holds x of all pixels row by row, then y, then z. predicted_V and predicted_flat_V, 104 each or none, are what
// a model predicts for this surface and for the flat sheet, untouched. Throws Error if the runtime refuses the cloud or
// does not answer in time.
inline std::uint64_t send_cloud(zmq::context_t &context, const std::vector<float> &xyz_mm,
                                const std::vector<double> &predicted_V = {},
                                const std::vector<double> &predicted_flat_V = {},
                                const std::string &endpoint = default_endpoint("control"),
                                const std::optional<Keys> &keys = {}, double timeout_s = 60.0) {
    std::string request(1, '\x81');  // a map, as long as what is added
    const auto text = [&](std::string_view value) { (request += static_cast<char>(0xa0 | value.size())) += value; };
    const auto bin = [&](std::string_view name, const void *data, std::size_t size) {
        if (!size) return;
        text(name);
        request += '\xc6';
        for (int shift = 24; shift >= 0; shift -= 8) request += static_cast<char>(size >> shift & 0xff);
        request.append(static_cast<const char *>(data), size);
        ++request[0];
    };
    text("command");
    text("cloud");
    bin("cloud", xyz_mm.data(), sizeof(float) * xyz_mm.size());
    bin("predicted", predicted_V.data(), sizeof(double) * predicted_V.size());
    bin("predicted_flat", predicted_flat_V.data(), sizeof(double) * predicted_flat_V.size());
    zmq::socket_t socket(context, zmq::socket_type::req);
    socket.set(zmq::sockopt::rcvtimeo, static_cast<int>(1000 * timeout_s));
    detail::connect(socket, endpoint, keys);
    socket.send(zmq::buffer(request), zmq::send_flags::none);
    zmq::message_t answer;
    if (!socket.recv(answer)) throw Error("no answer from " + endpoint + ": is `eitskin run` running there?");
    detail::Reader in(answer.data(), answer.size());
    std::uint64_t revision = 0;
    std::string refusal;
    for (std::uint64_t left = in.map(); left && !in.wrong; --left) {
        const std::string_view key = in.text();
        if (key == "cloud") revision = in.count();
        else if (key == "error") refusal = in.text();
        else in.skip();
    }
    if (in.wrong) throw Error("the answer of " + endpoint + " makes no sense: is it a runtime's control endpoint?");
    if (!refusal.empty()) throw Error(refusal);
    return revision;
}

}  // namespace eitskin
